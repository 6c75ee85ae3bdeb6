"""`calibrate BAG --out FILE`: where the camera stands, from a recording of a board in the hand or on the
table."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from np_common.cli import Parser, Progress
from np_perception.calibration.board_layout import BoardLayout

if TYPE_CHECKING:  # what is slow to import comes after the options are read
    from np_perception.calibration.board import Board
    from np_perception.calibration.fitting import CalibrationResult


def add_board(parser: argparse.ArgumentParser) -> None:
    """The options that describe the board."""
    default = BoardLayout()
    parser.add_argument("--columns", type=int, default=default.columns, help="squares (default %(default)s)")
    parser.add_argument("--rows", type=int, default=default.rows, help="squares (default %(default)s)")
    parser.add_argument("--square", type=float, default=default.square, help="measured side, m (default %(default)s)")
    parser.add_argument("--marker", type=float, default=default.marker, help="measured side, m (default %(default)s)")
    parser.add_argument("--dictionary", default=default.dictionary, help="OpenCV's name (default %(default)s)")


def board_of(options: argparse.Namespace) -> Board:
    """The board of the options. Raises BoardError."""
    from np_perception.calibration.board import Board

    return Board(options.columns, options.rows, options.square, options.marker, options.dictionary)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="calibrate", description=__doc__)
    parser.add_argument("bag", type=Path, help="recording of joint_states, camera/image_raw and camera/camera_info")
    parser.add_argument("--out", type=Path, required=True, help="file to write, for the parameter `calibration`")
    parser.add_argument(
        "--touched",
        default="",
        help=(
            "the board lies on the table, and the closed fingertips rested on these of "
            "its corners in this order, as 0,5,18,23,8,15; without it the hand holds the board"
        ),
    )
    parser.add_argument("--table", type=Path, help="recording of the board lying on the table, to see where that is")
    parser.add_argument(
        "--accept",
        action="store_true",
        help="write the file though lens or board look other than they were said to be",
    )
    add_board(parser)
    return parser.parse_args(arguments)


def summary(result: CalibrationResult, out: Path) -> dict[str, object]:
    """What the command prints, in mm, degrees and px."""
    calibration, fit, check = result.calibration, result.fit, result.check
    distance, angle = calibration.displacement
    found: dict[str, object] = {
        "calibration": str(out),
        "views": calibration.errors.views,
        "corners": calibration.errors.corners,
        "views_left_out": fit.left_out,
        "reprojection_rms_px": round(fit.rms, 3),
        "position_m": np.round(calibration.position, 5).tolist(),
        "position_95_mm": round(1e3 * calibration.errors.position_95, 2),
        "rotation_95_deg": round(float(np.degrees(calibration.errors.rotation_95)), 3),
        "keypoint_95_px": round(calibration.errors.keypoint_95, 2),
        "displaced_mm": round(1e3 * distance, 1),
        "displaced_deg": round(float(np.degrees(angle)), 2),
        "focal": _list([check.focal, check.focal_95]),
        "principal_point_px": [_list(check.centre), _list(check.centre_95)],
        "board_scale": _list([check.scale, check.scale_95]),
        "complaints": check.complaints(),
    }
    if (table := calibration.table) is not None:
        found["table"] = {
            "height_mm": [round(1e3 * table.height, 2), round(1e3 * table.height_95, 2)],
            "tilt_deg": np.round(np.degrees([*table.tilt, table.tilt_95]), 3).tolist(),
        }
    return found


def _bar(what: str) -> Callable[[int, int], None]:
    """Shows how many of how many images have been looked at."""
    bars: list[Progress] = []

    def show(done: int, total: int) -> None:
        bars[:] = bars or [Progress(total, what)]
        bars[0].show(done)

    return show


def _list(values) -> list[float | None]:
    """Rounded; None for what is undetermined (JSON has no infinity)."""
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: refused, and no file is written."""
    options = parse(arguments)
    from np_perception.calibration.board import BoardError
    from np_perception.calibration.evidence import CalibrationRefusal, read_calibration_data
    from np_perception.calibration.fitting import calibrate
    from np_record.bag import BagError

    try:
        board = board_of(options)
        touched = [int(number) for number in options.touched.split(",")] if options.touched else []
        evidence = []
        for path in (options.bag, options.table):
            if path is not None:
                evidence.append(read_calibration_data(path, board, _bar(f"reading {path}")))
        result = calibrate(
            evidence[0],
            board,
            datetime.now(UTC),
            touched=touched,
            table=evidence[1] if options.table else None,
            source=str(options.bag),
            accept=options.accept,
        )
        result.calibration.save(options.out)
        if evidence[0].is_legacy:
            print("calibrate: the board is of OpenCV's layout before 4.6; it was read as such", file=sys.stderr)
    except (BagError, BoardError, CalibrationRefusal, OSError, ValueError) as error:
        print(f"calibrate: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 1
    print(json.dumps(summary(result, options.out)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

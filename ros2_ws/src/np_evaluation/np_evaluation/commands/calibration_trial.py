"""`calibration_trial --out DIR`: calibrate rendered cameras whose poses are known, and compare the results with
the truth."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from np_common.cli import Parser


def run(out: Path, cameras: int, views: int, seed: int) -> dict[str, object]:
    """Every camera with every arm; the summary. out: folder for calibration.json and _view.png."""
    # Slow to import, and not needed by --help.
    import numpy as np

    from np_common.cli import Progress
    from np_description.weights.provenance import origin
    from np_evaluation.calibration_trial.drawing import picture
    from np_evaluation.calibration_trial.trial import ARMS, run_trial, summary

    out.mkdir(parents=True, exist_ok=True)
    revision = origin()["revision"]
    progress, rows, calibration = Progress(cameras * len(ARMS), "cameras"), [], None
    with tempfile.TemporaryDirectory() as folder:
        for arm in ARMS:
            for number in range(cameras):
                found, kept = run_trial(number, arm, seed, views, Path(folder))
                rows += found
                calibration = (kept, number) if kept is not None else calibration
                progress.show(len(rows) // 2)
    uncalibrated = [row["uncalibrated"] for row in rows if "uncalibrated" in row]
    report = {
        "summary": summary(rows),
        "uncalibrated_keypoint_mean_px": float(np.median([row["keypoint_mean_px"] for row in uncalibrated])),
        "uncalibrated_object_mean_mm": float(np.median([row["object_mean_mm"] for row in uncalibrated])),
        "seed": seed,
        "revision": revision,
    }
    (out / "calibration.json").write_text(json.dumps({**report, "cameras": rows}, indent=1) + "\n")
    if calibration is not None:
        picture(*calibration, seed, out / "calibration_view.png")
    return report


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="calibration_trial", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for calibration.json and _view.png")
    parser.add_argument("--cameras", type=int, default=10, help="how many (default %(default)s)")
    parser.add_argument("--views", type=int, default=16, help="postures of the hand (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the cameras (default %(default)s)")
    options = parser.parse_args(arguments)
    print(json.dumps(run(options.out, options.cameras, options.views, options.seed)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

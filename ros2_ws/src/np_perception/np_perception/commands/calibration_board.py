"""`calibration_board --out FILE`: the board to print, on A4, to scale."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from np_common.cli import Parser
from np_perception.commands.calibrate import add_board, board_of


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="calibration_board", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="PNG to write, 600 dots an inch")
    add_board(parser)
    options = parser.parse_args(arguments)
    # Slow to import, and not needed by --help.
    from PIL import Image

    from np_perception.calibration.board import BoardError
    from np_perception.calibration.printing import DPI, page

    try:
        board = board_of(options)
        sheet = page(board)
        # cv2 writes no resolution: PIL does, so that "100 %" means the size that was meant.
        options.out.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(sheet).save(options.out, dpi=(DPI, DPI))
    except (BoardError, OSError, ValueError) as error:
        print(f"calibration_board: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 1
    print(
        json.dumps(
            {
                "board": str(options.out),
                "squares": [board.columns, board.rows],
                "square_m": board.square,
                "marker_m": board.marker,
                "dictionary": board.dictionary,
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Videos of recorded episodes, drawn on the CPU: the scene's camera, the goal's outline, how it ended.

python -m np_training.video runs/bump/episodes.npz --count 8 --out runs/bump
python -m np_training.video runs/bump/episodes.npz --count 4 --strips runs/bump/strips.jpg    # one picture
"""

from __future__ import annotations

import json
from pathlib import Path

from np_common.cli import Parser


def main() -> None:
    """Draw a recording; the last line is one JSON object."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--out", type=Path, help="folder; default: the recording's")
    parser.add_argument("--strips", type=Path, help="one picture in place of videos")
    parser.add_argument("--renderer", default="auto", help="auto, egl or warp")
    arguments = parser.parse_args()
    from np_training.episodes.drawing import draw_recording, draw_strips  # slow: no --help should wait for the renderer

    if arguments.strips:
        draw_strips(arguments.recording, arguments.strips, arguments.count, arguments.renderer)
        print(json.dumps({"files": [str(arguments.strips)]}))
        return
    files = draw_recording(
        arguments.recording, arguments.out or arguments.recording.parent, arguments.count, arguments.renderer
    )
    print(json.dumps({"files": [str(file) for file in files]}))


if __name__ == "__main__":
    main()

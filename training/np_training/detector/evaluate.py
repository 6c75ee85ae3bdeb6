"""Judge a released detector on images it has not seen, drawn by the renderers of the deployed camera.

    python -m np_training.detector.evaluate --domain card --images 5000

Three sets: `nominal`, the scene as the bridge draws it, by OpenGL; `shifted`, by OpenGL, with table patterns
never used in training, other lights and colours, and the camera within 2 cm and 2 degrees of its place;
`ray_caster`, the nominal scene by MuJoCo Warp's ray caster, one ray a pixel. If requested, `meshes`: the scenes of `nominal`
with the arm as it looks (`make meshes`). With --episodes, three fifths of the
states are ones that the released policies pass through
(`np_training.evaluate --released DOMAIN --conditions paper --record FILE`). Writes
the domain's part of docs/results/detector.json and, of the best, median and worst detections, of
docs/results/detector.png; prints the JSON. Without OpenGL only the last set is judged.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS

SETS = ("nominal", "shifted", "ray_caster", "meshes")
ALWAYS = SETS[:3]


def main() -> None:
    """Command line; the last line printed is the figures as JSON."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--object", default="default", help="a rigid row, or a .yaml file: a box of another size")
    parser.add_argument("--weights", default="", help="folder of weights; default: the released ones")
    parser.add_argument("--images", type=int, default=5000, help="of each set")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(ALWAYS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--episodes", type=Path, help="recording of np_training.evaluate: most states come from it")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    from np_training.detector.judging import judge_released  # slow: no --help should wait for PyTorch

    print(json.dumps(judge_released(options)))


if __name__ == "__main__":
    main()

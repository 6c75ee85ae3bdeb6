"""Distil the pre-contact policy into the student that takes keypoints.

    python -m np_training.distill --checkpoint runs/card/checkpoint.pt --out runs/card --minutes 2

The teacher takes poses. The student takes 16 keypoint and 16 goal coordinates and gives 6D rotation, position
and width, trained by mean squared error (paper) on fresh tasks with keypoint noise.
"""

from __future__ import annotations

import json
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_training.device import DEVICE_HELP, usable
from np_training.options import duration
from np_training.physics.supported_effects import load_effects
from np_training.setting import OBJECT_HELP


def main() -> None:
    """Distil the checkpoint's pre-contact policy; writes pre_contact_student_DOMAIN.safetensors."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), help="default: the checkpoint's")
    parser.add_argument("--object", help=f"{OBJECT_HELP}; default: the checkpoint's")
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=duration, default=2.0)
    parser.add_argument("--steps", type=int, help="do so many steps instead")
    parser.add_argument(
        "--practice",
        type=float,
        default=0.0,
        help="share of tasks that are practice's, whose objects lie where none begins: for contacts after the first",
    )
    parser.add_argument("--batch", type=int, default=8192)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--sizes",
        type=float,
        nargs=2,
        default=(1.0, 1.0),
        metavar=("LOW", "HIGH"),
        help="of a teacher that was trained with `--conditions sized`: range of the factor of the object's edges",
    )
    parser.add_argument("--effects", type=Path, help="patch.yaml: its camera gives the student's keypoints")
    parser.add_argument("--begin", type=Path, metavar="FILE", help="weights of a student that is taught on")
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FOLDER",
        help="also write both policies there, as the nodes load them, unreleased",
    )
    parser.add_argument("--device", help=DEVICE_HELP)
    arguments = parser.parse_args()
    arguments.sizes = tuple(arguments.sizes)
    if not 0 < arguments.sizes[0] <= 1 <= arguments.sizes[1]:
        parser.error("--sizes: expected a range with 1 in it, got {:g} to {:g}".format(*arguments.sizes))
    try:
        arguments.effects = load_effects(arguments.effects)
    except ValueError as error:
        parser.error(str(error))
    from np_training.checkpoints import CheckpointError
    from np_training.ppo.distillation import distil_checkpoint  # slow: no --help should wait for PyTorch

    arguments.device = usable(arguments.device)
    try:
        result = distil_checkpoint(arguments, parser.error)
    except CheckpointError as error:
        parser.error(str(error))
    print(json.dumps(result))


if __name__ == "__main__":
    main()

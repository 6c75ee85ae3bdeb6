"""Success of trained policies in the batched simulator at zeta*, and how they fail.

    python -m np_training.evaluate --checkpoint runs/card/checkpoint.pt [--student FILE] \\
        --conditions nominal paper --set stiffness=4 --episodes 1000 --seeds 1000 1001 --out runs/card/evaluation.jsonl

One JSON object a line and condition, printed and appended to --out. `--recipe` judges under what the recipe names. Domain, object and
time limit are the checkpoint's. In place of one, --released DOMAIN plays the weights
that the nodes load, contacts chosen by the student. --video N draws episodes, half of them failures where there are as
many.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_description.objects.scenarios import COUNT
from np_description.weights.released import WeightsError
from np_training.device import DEVICE_HELP, usable
from np_training.physics.config import STEPPING, PhysicsConfig
from np_training.physics.supported_effects import load_effects
from np_training.setting import OBJECT_HELP
from np_training.tasks.randomisation import CONDITIONS


def main() -> None:
    """Evaluate checkpoints; every line printed is one JSON object."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), help="default: the checkpoint's")
    parser.add_argument("--object", help=f"{OBJECT_HELP}; default: the checkpoint's")
    parser.add_argument(
        "--scenario", type=int, choices=range(COUNT + 1), default=0, help="a fixed task; 0: tasks are drawn"
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--checkpoint", type=Path)
    source.add_argument("--released", choices=list(DOMAINS), help="the weights that the nodes load, of a domain")
    parser.add_argument(
        "--student", type=Path, help="weights that choose the contact from keypoints, in the teacher's place"
    )
    parser.add_argument("--episodes", type=int, default=1000, help="of each seed")
    parser.add_argument("--conditions", nargs="+", choices=list(CONDITIONS), default=["nominal"])
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="FIELD=VALUE",
        help="of the conditions, a number for both ends of a range",
    )
    parser.add_argument("--recipe", type=Path, help="a file of recipes/: judge under what it names")
    parser.add_argument("--seeds", "--seed", nargs="+", type=int, default=[1000])
    parser.add_argument("--largest-turn", type=float, help="rad, from start to goal; default: the checkpoint's")
    parser.add_argument("--tolerance", type=float, default=1.0, help="share of the domain's that counts as success")
    parser.add_argument("--hold", type=int, default=3, help="steps at the goal that count as success")
    parser.add_argument(
        "--reflex",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="whether joints beyond their limits of speed or position end an episode",
    )
    parser.add_argument("--limit", type=int, help="steps an episode; default: the checkpoint's")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument(
        "--effects", type=Path, help="patch.yaml of the diagnosis: what the arm has besides the nominal one"
    )
    parser.add_argument(
        "--contact", choices=list(STEPPING), help="see np_description.contact; default: the checkpoint's"
    )
    parser.add_argument("--out", type=Path, help="file to which the lines are appended")
    parser.add_argument(
        "--record", type=Path, help="file (.npz) for the joint positions of the last condition's episodes"
    )
    parser.add_argument("--video", type=int, metavar="N", help="draw N of the recorded episodes beside --record")
    parser.add_argument("--device", help=DEVICE_HELP)
    arguments = parser.parse_args()
    if arguments.video and not arguments.record:
        parser.error("--video needs --record FILE, beside which it writes")
    try:
        effects = load_effects(arguments.effects)
    except ValueError as error:
        parser.error(str(error))
    from np_training.checkpoints import CheckpointError
    from np_training.episodes.evaluation import evaluate_all  # slow: no --help should wait for PyTorch

    arguments.device = usable(arguments.device)
    try:
        for line in evaluate_all(arguments, effects, parser.error):
            print(line, flush=True)
            if arguments.out:
                with arguments.out.open("a") as file:
                    file.write(line + "\n")
    except (CheckpointError, WeightsError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()

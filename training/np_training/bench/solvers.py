"""The fused contact solver against the library's, in one run on one device.

    python -m np_training.bench.solvers --domain card --checkpoint runs/card/checkpoint.pt --seconds 5

- agreement: solutions of visited states against MuJoCo in C (float64), and how far objects drift apart in .3 s;
- speed: rollouts and whole training in policy steps a second, physics in physics steps a second, the parts of an iteration,
  and what room for contacts and constraints a rollout uses;
- success: of nominal episodes, the same tasks with both.

Every part is printed as one line of JSON when it is done, with `--out` appended to that file as well; the last line has all.
"""

from __future__ import annotations

import json
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_training.device import DEVICE_HELP, usable
from np_training.physics.config import STEPPING, PhysicsConfig
from np_training.ppo.config import TrainConfig

PARTS = ("agreement", "speed", "success")


def main() -> None:
    """Measure and print."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--checkpoint", type=Path, required=True, help="policies to measure with")
    parser.add_argument("--contact", choices=list(STEPPING), default="swift")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="room a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="room a world")
    parser.add_argument("--device", help=DEVICE_HELP)
    parser.add_argument("--worlds", type=int, default=24576)
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each figure")
    parser.add_argument("--episodes", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    arguments.device = usable(arguments.device)
    import torch  # slow: no --help should wait for it

    from np_training.bench.solver_comparison import compare_solvers

    torch.backends.cuda.matmul.allow_tf32 = True
    on_cuda = arguments.device.startswith("cuda")
    whole = {
        "domain": arguments.domain,
        "contact": arguments.contact,
        "room": [arguments.contacts, arguments.constraints],
        "device": torch.cuda.get_device_name(arguments.device) if on_cuda else "CPU",
    }
    for part in compare_solvers(arguments):
        whole |= part
        report(part, arguments.out)
    report(whole, arguments.out)


def report(found: dict, path: Path | None) -> None:
    """A line of JSON to standard output and to the end of a file."""
    line = json.dumps(found)
    print(line, flush=True)
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


if __name__ == "__main__":
    main()

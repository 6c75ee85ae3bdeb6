"""How much of the bare physics the training gets: one process, one device, one scene.

    python -m np_training.bench.throughput --domain card --checkpoint runs/card/checkpoint.pt --seconds 20

- trainer: whole iterations, rollout and update of both policies, starts drawn, as `np_training.train` does
them;
- environment: the same rollouts without update: observation, policy, inverse kinematics, step, reward, reset;
- bare_contact: `BatchedPhysics.advance` alone, from the states and commands that such a rollout went through;
- bare_free: the same with the arm at its ready posture, holding, and the object resting where no one touches
it.

All four step the same model with the same options; figures are physics steps a second, over all worlds. Beside them
`parts_ms`, where an iteration's time goes, in ms a policy period: the device is waited for before and after each part,
which makes the iteration longer than it is. inverse_kinematics is part of step and reset. Give a checkpoint: what an
untrained policy touches costs less. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_training.device import DEVICE_HELP, usable
from np_training.ppo.config import TrainConfig


def main() -> None:
    """Measure and print."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--checkpoint", type=Path, help="policies to measure with; default: untrained ones")
    parser.add_argument("--device", help=DEVICE_HELP)
    parser.add_argument("--worlds", type=int, default=24576)
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each figure")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    from np_training.bench.measuring import measure_throughput  # slow: no --help should wait for PyTorch

    arguments.device = usable(arguments.device)
    print(json.dumps(measure_throughput(arguments)))


if __name__ == "__main__":
    main()

"""Train the keypoint detector of a domain on images rendered as it goes.

    python -m np_training.detector.train --domain card --out runs/detector --seed 0 --minutes 6

Continues from OUT/checkpoint.pt if there is one. Writes, about once a minute and at the end, the checkpoint,
a line of OUT/curves.csv and OUT/keypoint_detector_DOMAIN.safetensors (moving average of the weights, training
record in its metadata). --minutes is the wall clock of the call, compilation and evaluation included.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_training.device import DEVICE_HELP, usable
from np_training.options import duration


def main(arguments: list[str] | None = None) -> None:
    """Command line; the last line printed is the held-out figures as JSON."""
    began = time.monotonic()
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--out", type=Path, required=True, help="folder of checkpoint, curves and weights")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=duration, default=6.0, help="wall clock of this call")
    parser.add_argument("--steps", type=int, help="do so many steps instead")
    parser.add_argument("--device", help=DEVICE_HELP)
    parser.add_argument("--batch", type=int)
    parser.add_argument("--rate", type=float)
    parser.add_argument("--pool", type=int)
    parser.add_argument("--episodes", type=Path, help="recording of np_training.evaluate: most states come from it")
    parser.add_argument("--start", type=Path, help="weights to begin with: a released .safetensors file")
    parser.add_argument(
        "--sizes",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        help="the object's edges times so much: all by one factor, each by its own, or none, image by image",
    )
    parser.add_argument("--reuse", type=int, help="batches from each rendering (default: 1; on a CPU 8 and more)")
    parser.add_argument("--no-contrast", action="store_true", help="without momentum contrast")
    background = parser.add_mutually_exclusive_group()
    background.add_argument("--keep-background", action="store_true", help="without replacing background and table")
    background.add_argument(
        "--always-background", action="store_true", help="replacing them in every image (paper), not in 60 %%"
    )
    parser.add_argument("--held-out", type=int)
    options = parser.parse_args(arguments)
    from np_training.detector.training import run  # slow: no --help should wait for PyTorch

    options.device = usable(options.device)
    print(json.dumps(run(options, began)))


if __name__ == "__main__":
    main()

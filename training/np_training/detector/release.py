"""Release a trained detector: weights, exported network, figures and model card, from the folder of a
training run.

    python -m np_training.detector.release runs/detector --domain card

Writes weights/keypoint_detector_DOMAIN.{safetensors,onnx,md} and the domain's part of
docs/results/detector.{json,png}.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS


def main() -> None:
    """Command line; prints the model card."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder that np_training.detector.train wrote")
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--weights", type=Path, default=Path("weights"))
    parser.add_argument("--results", type=Path, default=Path("docs/results"))
    parser.add_argument("--images", type=int, default=500, help="held out, of each set")
    parser.add_argument("--seed", type=int, default=1, help="of the held-out images")
    parser.add_argument("--episodes", type=Path, help="recording from which most held-out states come")
    options = parser.parse_args()
    import torch  # slow: no --help should wait for it

    from np_training.detector.releasing import release

    torch.set_num_threads(1)
    print(
        release(
            options.run,
            options.domain,
            options.weights,
            options.results,
            options.images,
            options.seed,
            options.episodes,
        ).read_text()
    )


if __name__ == "__main__":
    main()

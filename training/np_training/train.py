"""Joint training of the pre- and post-contact policies.

    python -m np_training.train --recipe recipes/card.yaml --seed 1
    torchrun --standalone --nproc-per-node 2 -m np_training.train --recipe recipes/card.yaml --seed 1

On several machines the same with `--nnodes` and `--rdzv-endpoint` (docs/guide/train.md); only the first process writes files.
A recipe that was trained to its end is distilled and judged then (np_training.finish). Resumes from `--out/checkpoint.pt` (or `--resume FILE`) as a matter of course, on any machine, with any number
of GPUs. Writes config.json; log.csv, a row an iteration; checkpoint.pt, every --save-every seconds and at the
end. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
import sys

from np_training.train_options import parse


def main() -> None:
    """Train, show progress, write checkpoints and curves."""
    arguments = parse()
    from np_training.checkpoints import CheckpointError
    from np_training.finish import finish
    from np_training.ppo import distributed  # slow: no --help should wait for PyTorch
    from np_training.ppo.training import run

    device = distributed.join(arguments.device)
    try:
        result = run(arguments, device)
        first = distributed.rank() == 0
    except CheckpointError as error:
        sys.exit(f"train: {error}")
    finally:
        distributed.leave()
    if first:
        if arguments.recipe and result["done"]:
            finish(arguments.recipe, arguments.out, arguments.device)
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()

"""Release trained policies: weights as safetensors, a model card beside each, curves as data and a plot.

    python -m np_training.release runs/bump --student runs/bump/pre_contact_student_bump.safetensors

Takes checkpoint.pt, log.csv, config.json and evaluation.jsonl from the run's folder, the domain and its object from the
checkpoint. training_DOMAIN.pt beside the weights is what `np_training.train --resume` goes on from. Weights for another object
than the domain's own go into a folder of their own (`--weights`), which the nodes take with `weights:=FOLDER`.
"""

from __future__ import annotations

import json
from pathlib import Path

from np_common.cli import Parser
from np_training.setting import OBJECT_HELP, RESULTS, WEIGHTS


def main() -> None:
    """Write weights/{pre,post}_contact_DOMAIN.safetensors with cards, and
    docs/results/training_DOMAIN.{json,csv,png}."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--student", type=Path, required=True)
    parser.add_argument("--object", help=f"{OBJECT_HELP}; default: the checkpoint's")
    parser.add_argument("--command", help="how it was trained; default: as in config.json")
    parser.add_argument("--note", default="", help="what a user has to know of its behaviour, for the cards")
    parser.add_argument("--machine", help="default: as in config.json")
    parser.add_argument(
        "--weights", type=Path, default=WEIGHTS, help="for another object than the domain's own: not this"
    )
    parser.add_argument("--results", type=Path, help=f"default: {RESULTS}; with another object: where the weights go")
    arguments = parser.parse_args()
    from np_training.reports.releasing import release_run  # slow: no --help should wait for PyTorch

    print(json.dumps(release_run(arguments, parser.error)))


if __name__ == "__main__":
    main()

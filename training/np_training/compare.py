"""Runs side by side: success against steps and wall time, and when each reached a success.

    python -m np_training.compare "with pi_pre=runs/bump" "from above=runs/bump_above" --success 0.95 \\
        --out docs/results/bump_pre

Writes OUT.png and OUT.json; the last line printed is one JSON object.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from np_common.cli import Parser
from np_training.setting import UNSAID

if TYPE_CHECKING:
    from np_training.report import Run

EVALUATED = ("steps", "conditions", "student", "success", "ci95", "episodes", "breaks_first")


def summary(run: Run, success: float) -> dict:
    """How a run was made, when it reached the success (None: never), and how it ended."""
    from np_training.reports.curves import reached  # slow: no --help should wait for Matplotlib

    last = run.rows[-1]
    return {
        "command": run.config.get("command", []),
        "seed": run.config.get("environment", {}).get("seed"),
        "device": run.config.get("device"),
        "processes": run.config.get("processes", 1),
        **{name: run.config.get("setting", {}).get(name, UNSAID[name]) for name in ("object", "reward")},
        "reached": reached(run.rows, success),
        "evaluations": [{name: line.get(name) for name in EVALUATED} for line in run.evaluations],
        "end": {name: last[name] for name in ("steps", "elapsed", "stage", "success")},
    }


def main() -> None:
    """Compare the runs named."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", help="NAME=FOLDER, or FOLDER")
    parser.add_argument("--success", type=float, default=0.95)
    parser.add_argument("--out", type=Path, required=True, help="path without ending")
    arguments = parser.parse_args()
    from np_training.report import read_run
    from np_training.reports.curves import draw_comparison, save

    folders = [run.rpartition("=") for run in arguments.runs]
    try:
        runs = {name or Path(folder).name: read_run(Path(folder)) for name, _, folder in folders}
    except ValueError as error:
        parser.error(str(error))
    if len(runs) < len(folders):
        parser.error(f"runs: expected a name of its own for each, got {', '.join(arguments.runs)}")
    result = {
        "success": arguments.success,
        "runs": {name: summary(run, arguments.success) for name, run in runs.items()},
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    save(draw_comparison({name: run.rows for name, run in runs.items()}), Path(f"{arguments.out}.png"))
    Path(f"{arguments.out}.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result))


if __name__ == "__main__":
    main()

"""The HTML report of a training run: one file with curves, figures, failures, videos and configuration.

    python -m np_training.report runs/bump

Reads log.csv, config.json and, where they are, evaluation.jsonl and evaluation_scene.jsonl (np_training.evaluate --out) and videos
(*.webm).
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from pathlib import Path

from np_common.cli import Parser
from np_common.html_pages import page, svg
from np_training.ppo.log import read_log
from np_training.reports.curves import draw_curves, find_success
from np_training.reports.words import task_label

PHYSICS_STEPS = 20  # a policy step, where the configuration does not set it


@dataclass(frozen=True)
class TrainingRun:
    """A training run's folder, read: rows of the log, configuration, evaluations (dicts), videos (files)."""

    path: Path
    rows: list[dict[str, float]]
    config: dict
    evaluations: list[dict]
    videos: list[Path]

    @property
    def title(self) -> str:
        """Its name: the domain, where the configuration has it, and the folder."""
        domain = self.config.get("setting", {}).get("domain", "")
        return f"Training of {self.path.name}" + (f" ({domain})" if domain not in ("", self.path.name) else "")

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Names and figures of the run."""
        last, config = self.rows[-1], self.config
        substeps = config.get("environment", {}).get("physics", {}).get("substeps", PHYSICS_STEPS)
        processes, setting = config.get("processes", 1), config.get("setting", {})
        facts = [
            ("command", " ".join(config.get("command", []))),
            *((("object", setting["object"]),) if "object" in setting else ()),
            ("machine", f"{processes} x {config.get('device', 'not recorded')}"),
            (
                "policy steps",
                f"{last['steps'] / 1e6:.1f} M ({last['steps'] * substeps / 1e9:.2f} G physics steps)",
            ),
            ("training time", f"{last['elapsed'] / 60:.1f} min"),
            ("stage at the end", f"{last['stage']:.0f}"),
            ("success at the end", f"{last['success']:.3f} of ended episodes, actions sampled"),
        ]
        for success in (0.5, 0.8, 0.95):
            when = find_success(self.rows, success)
            text = (
                "not reached"
                if when is None
                else (
                    f"{when['steps'] / 1e6:.0f} M policy steps, {when['seconds'] / 60:.1f} min, "
                    f"stage {when['stage']:.0f}"
                )
            )
            facts.append((f"success of {success}", text))
        return facts


def read_run(path: Path) -> TrainingRun:
    """Read a run's folder. Raises ValueError where there is no log or it is empty."""
    log = path / "log.csv"
    rows = read_log(log)
    if not rows:
        raise ValueError(f"run {path}: expected log.csv with a row, found {'none in it' if log.exists() else 'no log'}")
    config = path / "config.json"
    judged = [file for name in ("evaluation.jsonl", "evaluation_scene.jsonl") if (file := path / name).exists()]
    return TrainingRun(
        path,
        rows,
        json.loads(config.read_text()) if config.exists() else {},
        [json.loads(line) for file in judged for line in file.read_text().splitlines()],
        sorted(path.glob("*.webm")),
    )


def write_report(run: TrainingRun, path: Path) -> None:
    """Write the report of a run."""
    videos = [(file.stem, base64.b64encode(file.read_bytes()).decode()) for file in run.videos]
    config = json.dumps(run.config, indent=1)
    text = page(
        "np_training", run=run, curves=svg(draw_curves(run.rows)), videos=videos, config=config, label=task_label
    )
    path.write_text(text, encoding="utf-8")


def main() -> None:
    """Write RUN/report.html; the last line is one JSON object."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, help="default: RUN/report.html")
    arguments = parser.parse_args()
    try:
        run = read_run(arguments.run)
    except ValueError as error:
        parser.error(str(error))
    path = arguments.out or arguments.run / "report.html"
    write_report(run, path)
    print(
        json.dumps(
            {
                "report": str(path),
                "rows": len(run.rows),
                "evaluations": len(run.evaluations),
                "videos": len(run.videos),
            }
        )
    )


if __name__ == "__main__":
    main()

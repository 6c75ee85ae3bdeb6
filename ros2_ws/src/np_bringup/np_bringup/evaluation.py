"""Results of an evaluation, one line of JSON for each episode, and their summary. No ROS."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from np_description.phases import SUCCEEDED
from np_record.intervals import wilson_interval
from np_record.recorded_episode import Outcome


@dataclass(frozen=True)
class Result:
    """One episode: number, how it ended, wall time s, engine. `declared` is "graph" where the graph broke down."""

    episode: int
    engine: str = field(default="mujoco", kw_only=True)
    success: bool
    declared: str
    reason: str
    failed_in: str
    distance: float | None
    angle: float | None
    duration: float
    wall_s: float


def result_of(episode: int, outcome: Outcome, wall_s: float) -> Result:
    """The result of an episode that came to an end."""
    return Result(
        episode,
        outcome.success,
        outcome.declared,
        outcome.reason,
        outcome.failed_in,
        round(outcome.distance, 6),
        round(outcome.angle, 6),
        round(outcome.duration, 3),
        round(wall_s, 2),
    )


def breakdown(episode: int, reason: str, wall_s: float) -> Result:
    """The result of an episode in which the graph broke down: a failure."""
    return Result(episode, False, "graph", reason, "graph", None, None, 0.0, round(wall_s, 2))


class Results:
    """Results so far, in a file that a killed run leaves complete up to its last finished episode.

    The file is <folder>/<hash of settings>.jsonl; its first line holds the settings. Episodes found in it
    are not run again. Raises ValueError for a file that holds something else.
    """

    def __init__(self, folder: Path, settings: Mapping[str, object]):
        text = json.dumps({"settings": dict(settings)}, sort_keys=True)
        name = "_".join(str(settings[key]) for key in ("domain", "keypoints", "controller", "seed") if key in settings)
        self.path = folder / f"{name}_{hashlib.sha256(text.encode()).hexdigest()[:8]}.jsonl"
        self.results: list[Result] = []
        folder.mkdir(parents=True, exist_ok=True)
        lines = self.path.read_text().splitlines(keepends=True) if self.path.exists() else []
        if lines and lines[0].rstrip("\n") != text:
            raise ValueError(f"{self.path}: expected results for {text}, found {lines[0].strip()}")
        for number, line in enumerate(lines[1:]):
            if not line.endswith("\n"):
                break  # cut off while it was written: that episode is run again
            try:
                result = Result(**json.loads(line))
            except (TypeError, ValueError) as error:
                raise ValueError(
                    f"{self.path}, line {number + 2}: expected one result, found {line.strip()}"
                ) from error
            if result.episode != number:
                raise ValueError(f"{self.path}, line {number + 2}: expected episode {number}, found {result.episode}")
            self.results.append(result)
        complete = [text + "\n", *(_line(result) for result in self.results)]
        if lines != complete:
            self.path.write_text("".join(complete))

    def add(self, result: Result) -> None:
        """Append one result, written out at once."""
        self.results.append(result)
        with self.path.open("a") as file:
            file.write(_line(result))


def summary(results: list[Result]) -> dict[str, object]:
    """The figures of an evaluation.

    success: rate by the truth; ci95: Wilson; failures: number by phase; declared_wrongly: episodes the
    graph took for a success that were none; missed: true successes that it did not declare.
    """
    successes = sum(r.success for r in results)
    return {
        "success": round(successes / len(results), 4) if results else None,
        "ci95": [round(bound, 4) for bound in wilson_interval(successes, len(results))],
        "episodes": len(results),
        "failures": dict(sorted(Counter(r.failed_in for r in results if not r.success).items())),
        "declared_wrongly": sum(r.declared == SUCCEEDED and not r.success for r in results),
        "missed": sum(r.declared != SUCCEEDED and r.success for r in results),
        "wall_s": round(sum(r.wall_s for r in results), 1),
    }


def _line(result: Result) -> str:
    return json.dumps(asdict(result)) + "\n"

"""Results of an evaluation, one line of JSON for each episode, and their summary. No ROS."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from np_common.intervals import wilson_interval
from np_control import force_watch
from np_control.force_watch import ForceFigures
from np_description import limit_share
from np_description.contact.depths import DepthHistogram
from np_description.phases import SUCCEEDED
from np_description.weights.released import sha256

if TYPE_CHECKING:  # it is slow to import
    from np_record.outcome import Outcome

CODE = (
    "np_common",
    "np_description",
    "np_ros",
    "np_record",
    "np_control",
    "np_perception",
    "np_planning",
    "np_policy",
    "sim2real",
    "np_sim_bridge",
    "np_physx_bridge",
    "np_bringup",
    "np_evaluation",
)
"""The packages whose code takes part in an evaluation."""


@dataclass(frozen=True)
class Result:
    """The result of one episode."""

    episode: int
    """Number."""
    engine: str = field(default="mujoco", kw_only=True)
    """mujoco or physx."""
    success: bool
    """By the true pose of the object."""
    declared: str
    """The phase at its end; "graph" where the graph broke down."""
    reason: str
    """The graph's reason for a failure."""
    failed_in: str
    """The phase in which it failed."""
    distance: float | None
    """Of the object from the goal, m."""
    angle: float | None
    """Of the object from the goal, rad."""
    duration: float
    """Simulated time, s."""
    wall_s: float
    """Wall time, s."""
    contacts: int = field(default=1, kw_only=True)
    """Number of contacts chosen."""
    depths: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Histogram of penetration depths by pair."""
    limit_shares: Sequence[Sequence[float]] = field(default_factory=list)
    """Largest shares of the joint limits (3, 7): speed, torque, range."""
    position_bound: float | None = field(default=None, kw_only=True)
    """Of the graph's estimate at the end, m; None where it had none."""
    angle_bound: float | None = field(default=None, kw_only=True)
    """Likewise, rad."""
    force: Mapping[str, object] = field(default_factory=dict)
    """`np_control.force_watch.ForceFigures` as a mapping; empty where the backend estimates no external force."""
    engine_version: str = field(default="", kw_only=True)
    """Version of the physics."""


def result_of(
    episode: int,
    outcome: Outcome,
    wall_s: float,
    depths: DepthHistogram | None = None,
    shares: np.ndarray | None = None,
    force: ForceFigures | None = None,
) -> Result:
    """The result of an episode that came to an end.

    depths: how deep things were in each other; shares (3, 7): of its limits that the arm reached; force: external, on the arm.
    """
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
        depths.as_dict() if depths else {},
        [] if shares is None else shares.round(4).tolist(),
        asdict(force) if force else {},
        contacts=outcome.contacts,
        position_bound=outcome.position_bound,
        angle_bound=outcome.angle_bound,
    )


def breakdown(episode: int, reason: str, wall_s: float) -> Result:
    """The result of an episode in which the graph broke down: a failure."""
    return Result(episode, False, "graph", reason, "graph", None, None, 0.0, round(wall_s, 2))


def summary(results: list[Result]) -> dict[str, object]:
    """The figures of an evaluation.

    success: rate by the truth; ci95: Wilson; first_contact: the rate of those that needed one contact, where some had more, with its
    own interval; failures: number by phase; declared_wrongly: episodes the
    graph took for a success that were none; missed: true successes that it did not declare; uncertainty: median and largest bounds of
    the graph's estimates at the ends, mm and degrees, where it had any; depth_mm: how deep shapes were in
    each other, fingertips apart, by pair, and the share of the time in which housing or links pushed; limit_share: how much of the
    arm's limits of speed, torque and range the episodes came to; force_n, raw_peak_n, touching_n, peak_by, reflex_stops, force_episodes: the external
    force, as in `np_control.force_watch.summary`.
    """
    successes = sum(r.success for r in results)
    again = max((r.contacts for r in results), default=1) > 1
    return {
        **_rate(successes, len(results)),
        **(
            {"first_contact": _rate(sum(r.success and r.contacts == 1 for r in results), len(results))} if again else {}
        ),
        "episodes": len(results),
        "failures": dict(sorted(Counter(r.failed_in for r in results if not r.success).items())),
        "declared_wrongly": sum(r.declared == SUCCEEDED and not r.success for r in results),
        "missed": sum(r.declared != SUCCEEDED and r.success for r in results),
        **_uncertainty(results),
        "depth_mm": DepthHistogram.summary(DepthHistogram(r.depths) for r in results).as_dict(),
        "limit_share": limit_share.summary(np.array(r.limit_shares) for r in results if r.limit_shares),
        **force_watch.summary(ForceFigures(**r.force) for r in results if r.force),
        "wall_s": round(sum(r.wall_s for r in results), 1),
    }


def reasons(results: Sequence[Result]) -> dict[str, int]:
    """The graph's reasons for failures with their counts, the most frequent first; numbers are replaced by #."""
    reason = (
        "declared a success and was none" if r.declared == SUCCEEDED else re.sub(r"-?\d+(\.\d+)?", "#", r.reason)
        for r in results
        if not r.success
    )
    return dict(Counter(reason).most_common())


def _uncertainty(results: Sequence[Result]) -> dict[str, dict[str, float]]:
    bounds = np.array([(r.position_bound, r.angle_bound) for r in results if r.position_bound is not None], float)
    if not len(bounds):
        return {}
    bounds *= 1e3, np.degrees(1.0)
    figures = {"median": np.median(bounds, axis=0), "max": bounds.max(axis=0)}
    return {
        "uncertainty": {
            f"{unit}_{name}": round(float(value), 2)
            for name, pair in figures.items()
            for unit, value in zip(("mm", "deg"), pair)
        }
    }


def _rate(successes: int, episodes: int) -> dict[str, object]:
    return {
        "success": round(successes / episodes, 4) if episodes else None,
        "ci95": [round(bound, 4) for bound in wilson_interval(successes, episodes)],
    }


def engine_version(engine: str) -> str:
    """Version of the physics of mujoco or physx: the library's version, and of PhysX that of our frozen scene."""
    if engine == "mujoco":
        return f"mujoco {version('mujoco')}"
    from np_physx_bridge.engine import VERSION

    return f"physx {VERSION} (sapien {version('sapien')})"


def code_sha256() -> str:
    """SHA-256 (hex) of every file of the packages that an evaluation runs, whether git tracks it or not, and of one's own
    effects."""
    from sim2real.effects.registry import FOLDERS  # slow

    folders = [Path(find_spec(package).submodule_search_locations[0]) for package in CODE]
    own = [Path(folder) for folder in os.environ.get(FOLDERS, "").split(":") if folder]
    total = hashlib.sha256()
    for root in (*folders, *own):
        for path in sorted(path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
            total.update(f"{root.name}/{path.relative_to(root)} {sha256(path)}\n".encode())
    return total.hexdigest()

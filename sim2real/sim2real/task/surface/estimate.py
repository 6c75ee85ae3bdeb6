"""Table and object by touch: is the table higher, is it tilted, is the object's height not the nominal one?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_description.panda import NOMINAL, PandaModel
from sim2real.excitation.contact_suite.workspace import RestingObject
from sim2real.task.hypotheses import HypothesisComparison, MeasuredChanges, compare_hypotheses
from sim2real.task.suite.object_pose import pose_at_start
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.surface.touch import Touch, find_touch
from sim2real.thresholds import THRESHOLDS

TOUCH = THRESHOLDS.surface_contact
MIDDLE = np.array([0.5, 0.0])  # m: where the table's height is given
EFFECTS = {"table_height": ("height",), "table_tilt": ("tilt_x", "tilt_y"), "object_size": ("size",)}
ALL = ("height", "tilt_x", "tilt_y", "size")


@dataclass(frozen=True, eq=False)
class SurfaceContactResult:
    """Table and object as the hand touched them."""

    verdict: str
    """no_gap, identified, ambiguous, unexplained or undetermined."""
    comparison: HypothesisComparison | None
    """Hypotheses for the heights; None where the stage abstains."""
    touches: tuple[Touch, ...]
    """Surfaces that were touched."""
    abstention_reason: str = ""
    """Why the stage abstains."""
    off: float | None = None
    """Root mean square m from the nominal table."""
    before: float | None = None
    """Root mean square m of each touch of the table as nominal, where the others estimate the table; None for too few."""
    after: float | None = None
    """The same with the findings."""

    @property
    def lift(self) -> float:
        """m by which the table is higher than nominal, where that is found."""
        best = (one.hypotheses[0] for one in (self.comparison.findings if self.comparison else ()))
        return sum(one.estimates["height"].value for one in best if one.name == "table_height")


def estimate_surfaces(recording: TaskRecording, panda: PandaModel = NOMINAL) -> SurfaceContactResult:
    """Of all touches of a recording. panda: the arm as it is."""
    tables = [t for name in recording.named("touch_table") if (t := find_touch(recording, name, panda))]
    tops = [t for name in recording.named("touch_object") if (t := find_touch(recording, name, panda))]
    every = (*tables, *tops)
    if len(tables) < 3:
        return SurfaceContactResult(
            "undetermined", None, every, f"{len(tables)} touches of the table met it; 3 are needed, better 4"
        )
    plane = _plane(tables)
    residual = np.array([t.height for t in tables]) - _columns(tables) @ plane
    off = float(np.sqrt(np.mean([t.height**2 for t in tables])))
    if np.abs(residual).max() > TOUCH.agreed:
        return SurfaceContactResult(
            "unexplained", None, every, f"touched places are {1e3 * np.abs(residual).max():.1f} mm off any plane", off
        )
    comparison = compare_hypotheses(_measure(recording, tables, tops))
    found = {one.hypotheses[0].name for one in comparison.findings}
    before, after = _held_out(tables, found)
    return SurfaceContactResult(comparison.verdict, comparison, every, "", off, before, after)


def _columns(touches) -> np.ndarray:
    """What the table's numbers (height, tilt about x, about y) do to the height of touched places (n, 3)."""
    places = np.array([t.place for t in touches]) - MIDDLE
    return np.column_stack([np.ones(len(places)), places[:, 1], -places[:, 0]])


def _plane(touches) -> np.ndarray:
    return np.linalg.lstsq(_columns(touches), np.array([t.height for t in touches]), rcond=None)[0]


def _measure(recording: TaskRecording, tables, tops) -> MeasuredChanges:
    """Table's numbers by least squares, and what the object is higher than its edge; with covariance."""
    columns = _columns(tables)
    noise = TOUCH.angle**2 + np.mean([t.deviation**2 for t in tables])
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = noise * np.linalg.inv(columns.T @ columns)
    covariance[0, 0] += TOUCH.common**2
    value = np.append(_plane(tables), 0.0)
    if tops:
        at = np.append(_columns(tops)[0], 0.0)
        value[3] = tops[0].height - at @ value - _upright_edge(recording)
        covariance[3, :3] = covariance[:3, 3] = -at[:3] @ (covariance[:3, :3] - np.diag([TOUCH.common**2, 0, 0]))
        covariance[3, 3] = at @ covariance @ at - TOUCH.common**2 + noise
    else:
        covariance[3, 3] = 1.0  # m: nothing is known
    usual, gap = zip(TOUCH.height, TOUCH.tilt, TOUCH.tilt, TOUCH.size)
    return MeasuredChanges(ALL, value, covariance, np.array(usual), np.array(gap), EFFECTS)


def _upright_edge(recording: TaskRecording) -> float:
    """m: the nominal length of the object's upright edge, by how it is seen to lie when it is touched."""
    return RestingObject.of(recording.domain, pose_at_start(recording, recording.named("touch_object")[0])).height


def _held_out(tables, found: set[str]) -> tuple[float, float] | tuple[None, None]:
    """Root mean square (m) by which a touch is off when the others locate the table: with the nominal set-up, and with the named effects."""
    if len(tables) < 4:
        return None, None
    free = [k for k, effect in ((0, "table_height"), (1, "table_tilt"), (2, "table_tilt")) if effect in found]
    before, after = [], []
    for n, one in enumerate(tables):
        others = tables[:n] + tables[n + 1 :]
        heights = np.array([t.height for t in others])
        numbers = np.linalg.lstsq(_columns(others)[:, free], heights, rcond=None)[0] if free else np.zeros(0)
        before.append(one.height)
        after.append(one.height - float(_columns([one])[0, free] @ numbers))
    return float(np.sqrt(np.mean(np.square(before)))), float(np.sqrt(np.mean(np.square(after))))

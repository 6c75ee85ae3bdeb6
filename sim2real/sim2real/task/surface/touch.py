"""One touch: the height at which a surface stopped the tip."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from np_description.panda import NOMINAL, PandaModel
from sim2real.excitation.contact_suite.tip import BEYOND, lowest_corner
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.wrench import arm_motion, tip_forces
from sim2real.thresholds import THRESHOLDS

TOUCH = THRESHOLDS.surface_contact
DOWNWARD = 0.01, 0.03  # m/s of the slow way down
ABOVE = 0.004  # m over the lowest point, from which on nothing is touched yet


@dataclass(frozen=True, eq=False)
class Touch:
    """A surface that stopped the tip."""

    name: str
    """Experiment."""
    place: np.ndarray
    """Touched place (2,) m."""
    height: float
    """Height m of the surface."""
    deviation: float
    """Standard deviation m of the height, from scatter."""
    compliance: float
    """Compliance m/N of arm and surface."""
    force: float
    """Largest force N."""
    course: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    """Height m and upward force N (n, 2) of the tip near the surface."""


def find_touch(recording: TaskRecording, name: str, panda: PandaModel = NOMINAL) -> Touch | None:
    """The surface of a touch; None where the way down met nothing.

    The tip goes on pressing where it is stopped: its height against the force is a line, whose end at no force is the surface.
    """
    moved = arm_motion(recording.log, recording.rows(name), panda)
    corner = lowest_corner(moved.tip - moved.turn @ np.array([0.0, 0.0, BEYOND]), moved.turn)
    deepest = int(corner[:, 2].argmin())
    down = -moved.moves[:, 2]
    before = np.arange(len(moved)) < deepest
    free = before & (down > DOWNWARD[0]) & (down < DOWNWARD[1]) & (corner[:, 2] > corner[deepest, 2] + ABOVE)
    if free.sum() < TOUCH.rows:
        return None
    upward = tip_forces(moved, moved.free(free), moved.tip, panda)[:, 2]
    near = (corner[:, 2] < corner[deepest, 2] + ABOVE) & (upward > TOUCH.least)
    near &= np.abs(moved.moves[:, 2]) < DOWNWARD[0] / 2
    if near.sum() < TOUCH.rows:
        return None
    force, height = upward[near], corner[near, 2]
    columns = np.column_stack([np.ones(near.sum()), -force])
    (surface, compliance), *_ = np.linalg.lstsq(columns, height, rcond=None)
    left = float(np.std(height - columns @ [surface, compliance]))
    if compliance < 0:  # noise of a surface that does not give way
        surface, compliance = float(height.mean()), 0.0
    place = corner[near, :2].mean(axis=0)
    shown = before & (corner[:, 2] < corner[deepest, 2] + 2 * ABOVE)
    course = np.column_stack([corner[shown, 2], upward[shown]])
    return Touch(name, place, float(surface), left, float(compliance), float(force.max()), course)

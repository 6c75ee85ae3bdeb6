"""How an episode ended, scored against the truth. No ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from np_description.domains import Pose, Task, is_success, pose_error
from np_description.phases import ACTIVE, FAILED, POST, PRE, SUCCEEDED, PhaseState, first_end, split_reason


@dataclass(frozen=True)
class Outcome:
    """How an episode ended."""

    declared: str
    """Phase in which the graph ended."""
    reason: str
    """Reason that the graph gave, or why the recording ends early."""
    distance: float
    """m, true position of the object to its goal at the end."""
    angle: float
    """rad, likewise."""
    success: bool
    """Whether both are within the task's tolerance."""
    duration: float
    """s of simulated time."""
    contacts: int = 1
    """Number of contacts that were chosen."""
    position_bound: float | None = None
    """m, of the graph's estimate at the end (np_perception.pose_estimation); None where the graph had none."""
    angle_bound: float | None = None
    """rad, likewise."""

    @property
    def failed_in(self) -> str:
        """The phase an episode failed in by the truth: pre, approach, post, fault, or "" for a success.

        An episode the graph took for a success, while the object is not at its goal, failed in post.
        """
        if self.success:
            return ""
        where, _ = split_reason(self.reason)
        if self.declared == FAILED and where in ACTIVE:
            return where
        return POST if self.declared == SUCCEEDED else self.declared


def note_position_only(domain: Task) -> str:
    """What stands beside an angle that does not count towards the domain's success, "" where it does."""
    return " (position only)" if domain.tolerance_angle is None else ""


def score_outcome(
    domain: Task, states: Sequence[PhaseState], pose: Pose, goal: Pose, duration: float, early: str = ""
) -> Outcome:
    """The outcome of an episode with an object that ended at `pose` (truth).

    states: the phases published up to its end or beyond; early: why there is no end, where the recording gives a reason.
    """
    distance, angle = pose_error(pose.position, pose.quaternion, goal.position, goal.quaternion)
    end = first_end(states)
    until = states.index(end) if end else len(states)
    contacts = max(1, sum(state.phase == PRE for state in states[:until]))
    declared, reason = (end.phase, end.reason) if end else ("unfinished", early)
    success = bool(is_success(domain, distance, angle))
    position_bound, angle_bound = (
        float(text) if text else None for text in ((end.position_bound, end.angle_bound) if end else ("", ""))
    )
    return Outcome(
        declared, reason, float(distance), float(angle), success, duration, contacts, position_bound, angle_bound
    )

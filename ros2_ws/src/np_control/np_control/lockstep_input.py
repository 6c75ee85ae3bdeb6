"""The controller's side of the lockstep barrier: what a policy tick needs before its state gets a command.

Messages of different topics arrive in any order. The gate keeps them until the state they belong to is due,
so that a run does not depend on that order. See docs/reference/graph.md, Lockstep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from np_description.phases import APPROACH, EXCITE, POST, PhaseState

TrajectoryT = TypeVar("TrajectoryT")
PoseT = TypeVar("PoseT")
GainsT = TypeVar("GainsT")


TRAJECTORY_PHASES = (APPROACH, EXCITE)
"""Phases in which the first tick waits for a trajectory; `excite` begins anew with each experiment."""


@dataclass(frozen=True)
class TickInputs(Generic[TrajectoryT, PoseT, GainsT]):
    """The inputs that take effect at a policy tick."""

    phase: str
    """The phase in force."""
    trajectory: tuple[TrajectoryT, GainsT | None] | None = None
    """The trajectory that begins, with its gains, or None for the controller's own."""
    target: tuple[PoseT, GainsT] | None = None
    """The target that begins: pose and gains."""


class LockstepCommandInput(Generic[TrajectoryT, PoseT, GainsT]):
    """Collects tick, trajectory and target of the policy ticks, multiples of `policy_period_ns`.

    None stands for a trajectory, pose or gains that came but were refused: the wait is over all the same, and
    nothing changes.
    """

    def __init__(self, policy_period_ns: int):
        self._period = policy_period_ns
        self._tick: tuple[int, PhaseState] | None = None
        self._trajectory: tuple[int, TrajectoryT | None] | None = None
        self.begin(0)

    def begin(self, stamp: int) -> None:
        """A new beginning with the state of `stamp` ns: drop what no stamp ties to a tick to come.

        Messages of later stamps are of a former run of the backend: time waits for us, so none can be ahead.
        """
        if self._tick is not None and self._tick[0] > stamp:
            self._tick = None
        if self._trajectory is not None and self._trajectory[0] > stamp:
            self._trajectory = None
        self._pose: tuple[int, PoseT | None] | None = None
        self._gains: tuple[GainsT | None] | None = None
        self._planned: tuple[str, str] | None = None  # phase and experiment whose trajectory has come

    def tick(self, stamp: int, state: PhaseState) -> None:
        """The tick of `stamp` ns, with the phase in force from then on."""
        self._tick = stamp, state

    def trajectory(self, stamp: int, trajectory: TrajectoryT | None) -> None:
        """The plan for the tick of `stamp` ns; None also where planning failed."""
        self._trajectory = stamp, trajectory

    def gains(self, gains: GainsT | None) -> None:
        """Gains for the pose that comes next, or that is already there without any."""
        self._gains = (gains,)

    def pose(self, stamp: int, pose: PoseT | None) -> None:
        """The target for the tick of `stamp` ns."""
        self._pose = stamp, pose

    def missing(self, stamp: int) -> str | None:
        """The topic that is still missing before the state of `stamp` ns can get a command, or None."""
        if stamp % self._period:
            return None
        if not _is_of(self._tick, stamp):
            return "episode/tick"
        state = self._tick[1]
        if self._awaits_trajectory(state) and not _is_of(self._trajectory, stamp):
            return "joint_trajectory"
        if self._awaits_trajectory(state) and state.phase == EXCITE and self._gains is None:
            return "target_gains"
        if state.phase == POST:
            if not _is_of(self._pose, stamp):
                return "target_pose"
            if self._gains is None:
                return "target_gains"
        return None

    def take(self, stamp: int) -> TickInputs[TrajectoryT, PoseT, GainsT] | None:
        """The inputs that take effect at the state of `stamp` ns, which is complete; None between ticks."""
        if stamp % self._period:
            return None
        state = self._tick[1]
        trajectory = target = None
        if self._awaits_trajectory(state):
            self._planned, gains = (state.phase, state.experiment), None
            if state.phase == EXCITE:
                (gains,), self._gains = self._gains, None
            is_complete = self._trajectory[1] is not None and (gains is not None or state.phase == APPROACH)
            trajectory = (self._trajectory[1], gains) if is_complete else None
        elif state.phase == POST:
            target = self._pose[1], self._gains[0]
            target = None if any(part is None for part in target) else target
            self._pose = self._gains = None
        if state.phase not in TRAJECTORY_PHASES:
            self._planned = None
        return TickInputs(state.phase, trajectory, target)

    def _awaits_trajectory(self, state: PhaseState) -> bool:
        return state.phase in TRAJECTORY_PHASES and (state.phase, state.experiment) != self._planned


def _is_of(stamped: tuple | None, stamp: int) -> bool:
    return stamped is not None and stamped[0] == stamp

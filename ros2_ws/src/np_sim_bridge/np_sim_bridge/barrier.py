"""The barrier of lockstep: the replies that time waits for (docs/reference/graph.md). No ROS."""

from __future__ import annotations

from np_description.phases import ACTIVE, EXCITE, POST
from np_sim_bridge.schedule import Schedule

ACTIVE_PHASES = (*ACTIVE, EXCITE)


class LockstepBarrier:
    """The replies that the state at `stamp` needs before time may go on.

    tick_barrier: whether policy ticks wait for the episode's tick, and in phase post for the policy's target;
    without it only the controller is waited for. All stamps are ns.
    """

    def __init__(self, schedule: Schedule, *, tick_barrier: bool):
        self._schedule, self._tick_barrier = schedule, tick_barrier
        self._command = self._target = self._tick = -1
        self._phase = ""
        self.stamp = 0

    def begin(self, stamp: int) -> None:
        """The state at `stamp` is published: wait for the replies to it, also if they came before."""
        self.stamp = stamp
        self._command = -1

    def command(self, stamp: int) -> None:
        """The controller's command for the state at `stamp` has come."""
        self._command = stamp

    def tick(self, stamp: int, phase: str) -> None:
        """The episode decided that `phase` is in force from `stamp` on."""
        self._tick, self._phase = stamp, phase

    def target(self, stamp: int) -> None:
        """The policy's target for the image at `stamp` has come."""
        self._target = stamp

    def missing(self) -> str | None:
        """The topic whose message is missing, the earliest in the chain first, or None when time may go on."""
        if self._tick_barrier and self._schedule.is_policy_tick(self.stamp):
            if self._tick != self.stamp:
                return "episode/tick"
            if self._phase == POST and self._target != self.stamp:
                return "target_pose"
        return None if self._command == self.stamp else "effort_command"

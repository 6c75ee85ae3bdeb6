"""The barrier of lockstep: the answers that time waits for (docs/reference/graph.md). No ROS."""

from __future__ import annotations

from np_description.phases import ACTIVE, EXCITE, POST
from np_sim_bridge.schedule import Schedule

ACTIVE_PHASES = (*ACTIVE, EXCITE)


class LockstepBarrier:
    """The answers that the state at `stamp` needs before time may go on.

    tick_barrier: whether policy ticks wait for the episode's tick, and in phase post for the policy's target;
    without it only the controller is waited for. All stamps are ns.
    """

    def __init__(self, schedule: Schedule, *, tick_barrier: bool):
        self._schedule, self._tick_barrier = schedule, tick_barrier
        self._command = self._target = self._tick = -1
        self._phase = ""
        self.stamp = 0

    def begin(self, stamp: int) -> None:
        """The state at `stamp` is out: wait for the answers to it, also if it was answered before."""
        self.stamp = stamp
        self._command = -1

    def command(self, stamp: int) -> None:
        """The controller answered the state at `stamp`."""
        self._command = stamp

    def tick(self, stamp: int, phase: str) -> None:
        """The episode decided that `phase` is in force from `stamp` on."""
        self._tick, self._phase = stamp, phase

    def target(self, stamp: int) -> None:
        """The policy answered the image at `stamp`."""
        self._target = stamp

    def missing(self) -> str | None:
        """The topic whose answer is missing, the earliest in the chain first, or None when time may go on."""
        if self._tick_barrier and self._schedule.is_policy_tick(self.stamp):
            if self._tick != self.stamp:
                return "episode/tick"
            if self._phase == POST and self._target != self.stamp:
                return "target_pose"
        return None if self._command == self.stamp else "effort_command"

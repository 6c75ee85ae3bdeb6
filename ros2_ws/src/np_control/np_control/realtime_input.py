"""What a controller follows in real time: everything takes effect when it comes, while an episode allows it. No
ROS.

The counterpart of `np_control.lockstep_input.LockstepCommandInput`, for the controller node and for a driver with the
controller on board."""

from __future__ import annotations

import numpy as np

from np_control.controller import Controller
from np_control.safety import Reason, Refusal
from np_control.trajectory import Trajectory
from np_description.phases import ACTIVE, APPROACH, AT_REST, ENDS, EXCITE, IDLE, POST, PRE

MOVING = (APPROACH, POST)
HEARTBEAT_NS = 120_000_000
"""Time without a heartbeat after which the owner of the phase counts as lost, ns: with the time of a stop the arm is at rest within 300 ms."""


class RealtimeCommandInput:
    """Leads one `Controller` by trajectories, by pairs of gains and pose, and by the phase of an episode.

    Once an episode has ended nothing is followed until the next one begins, or something else has a phase: a
    plan that comes late was made for an arm that moves no more. In phase pre a plan waits until the episode has taken it, which
    phase approach says. Without any phase all is followed. phase: in force, "" before the first. Time is that of the controller's states.
    """

    def __init__(self, controller: Controller):
        self._controller = controller
        self._gains: np.ndarray | None = None
        # A plan that came in phase pre, where it starts, and its gains.
        self._planned: tuple[Trajectory, int | None, np.ndarray | None] | None = None
        self.phase = ""
        self._is_open = True
        self._is_new = False  # the arm's beginning, and no phase has been received since
        # Stamp ns of the state at the last heartbeat; None: time runs from the next state.
        self._heard: int | None = None
        self._is_lost = False

    def enter(self, phase: str) -> bool:
        """The phase in force from now on. A new episode begins with a hold; at the end of one the arm comes to rest.

        Returns whether a plan that came before is followed from now on. Raises Refusal where it begins elsewhere.
        """
        self._heard = self._controller.stamp
        if phase == self.phase:
            return False
        missed = self._is_new and phase in MOVING  # the start of this episode
        cut_off = phase == IDLE and self.phase in ACTIVE  # the owner was restarted
        self.phase, self._is_open, self._is_new = phase, not (missed or cut_off or phase in ENDS), False
        if phase == PRE:
            self._controller.hold()
        elif phase in AT_REST:
            self._controller.stop()
        planned, self._planned = self._planned, None
        if planned is None or phase != APPROACH or not self._is_open:
            return False
        self._controller.follow(*planned)
        return True

    def begin(self) -> None:
        """The arm is not where it was, as after a restart of what drives it: an episode under way moved another.

        Without a phase yet, the first to come decides whether there is an episode: it is latched, and comes when its publisher is found.
        """
        if self.phase in MOVING:
            self._is_open = False
        self._is_new = not self.phase
        self._heard = self._planned = None

    def heartbeat(self, phase: str) -> None:
        """The owner of the phase is alive; a heartbeat of another phase than the one in force is ignored."""
        if phase == self.phase:
            self._heard = self._controller.stamp

    def check_owner(self) -> None:
        """Break off what the owner of the phase is no longer there to end. Call it before each state.

        Up to the state before: a heartbeat may wait behind the new one in the queue. Raises Refusal(heartbeat), once for each loss.
        """
        was_lost = self._is_lost
        self._is_lost = self._is_silent() and (self.phase in MOVING or self._controller.follows_trajectory)
        if self._is_lost and not was_lost:
            self._controller.stop()
            raise self._silence()

    def _is_silent(self) -> bool:
        """Whether the phase has an owner, and its heartbeat has been missing for too long."""
        stamp = self._controller.stamp
        if stamp is None or self.phase not in (*ACTIVE, EXCITE):
            return False
        self._heard = stamp if self._heard is None else self._heard
        return stamp - self._heard > HEARTBEAT_NS

    def _silence(self) -> Refusal:
        return Refusal(
            Reason.HEARTBEAT,
            f"expected episode/heartbeat in phase {self.phase}, got none for {HEARTBEAT_NS / 1e6:.0f} ms",
        )

    def check_open(self) -> None:
        """Raises Refusal where nothing is to be followed now: state, heartbeat."""
        if not self._is_open:
            raise Refusal(
                Reason.STATE,
                f"expected an episode under way, with the arm as it was at its start; the phase is {self.phase}",
            )
        if self._is_silent():
            raise self._silence()

    def trajectory(self, trajectory: Trajectory | None, start: int | None = None) -> bool:
        """Follow a plan from the state of `start` ns on, or from now. None (no plan) changes nothing.

        Its gains are those that came since the last pose or plan, or else the controller's own. Returns whether it is
        followed: in phase pre it waits. Raises Refusal.
        """
        if trajectory is None:
            return False
        gains, self._gains = self._gains, None
        if self.phase == EXCITE:  # sent by the owner, which may have thought about it for long
            self.heartbeat(EXCITE)
        self.check_open()
        if self.phase == PRE:
            self._planned = trajectory, start, gains
            return False
        self._controller.follow(trajectory, start, gains)
        return True

    @property
    def has_plan(self) -> bool:
        """Whether a plan waits for phase approach."""
        return self._planned is not None

    def gains(self, gains: np.ndarray | None) -> None:
        """Gains (2, 7), stiffness Nm/rad and damping ratio, for the pose or the plan that comes next; None drops
        them."""
        self._gains = gains

    def forget(self) -> None:
        """Drop gains and a plan that wait."""
        self._gains = self._planned = None

    def pose(self, stamp: int, pose: tuple[np.ndarray, np.ndarray] | None) -> bool:
        """Move T_E to `pose`, position (3,) m and rotation (3, 3), with the gains that came since the last
        pose.

        stamp: ns of the state that it was computed from. None stands for a pose that was refused: it uses the gains up.
        Returns whether it was cut to the workspace. Raises Refusal, `unpaired` where there are no gains.
        """
        gains = self.take_gains(stamp)
        return pose is not None and self._controller.set_target(stamp, *pose, *gains)

    def take_gains(self, stamp: int) -> np.ndarray:
        """The gains (2, 7) for the pose of `stamp` ns. Raises Refusal: unpaired where none came since the last
        pose, state where nothing is to be followed.
        """
        gains, self._gains = self._gains, None
        if gains is None:
            raise Refusal(Reason.UNPAIRED, f"target pose of {stamp} ns came without gains")
        self.check_open()
        return gains

"""Invariants that must hold under all faults, checked at every step of the arm and every message; each names the page that guarantees it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from np_control.safety import LIMITS, State
from np_description.domains import Task, is_success, pose_error
from np_description.message_arrays import BadMessage
from np_description.phases import ACTIVE, APPROACH, FAILED, FAULT, IDLE, POST, PRE, SUCCEEDED, PhaseState
from np_evaluation.simtest.scheduler import Scheduler
from np_ros.goals import GOAL, goal_text
from np_ros.phases import phase_state

GUARANTEES = {
    "torque": "graph.md, Refused commands and watchdogs: torque, torque rate",
    "range": "graph.md, Refused commands and watchdogs: soft walls, speed",
    "rest": "graph.md, Refused commands and watchdogs: 200 ms without a command, stop, fault, no episode/heartbeat",
    "reflex": "driver.md, force reflex",
    "motion": "graph.md, Goals: a goal is accepted before anything moves",
    "recover": "graph.md, Refused commands and watchdogs: only recover resumes",
    "phases": "graph.md, Phases",
    "refusals": "graph.md, Refused commands and watchdogs: every refused message is counted",
    "success": "graph.md, Phases: success",
    "alive": "graph.md, Refused commands: a node refuses and counts, it does not die",
    "goes_on": "graph.md, Phases: after recover and reset an episode runs to its end",
    "recording": "graph.md, Recording",
    "replay": "graph.md, Recording: replay is equal byte by byte",
}
REST_TIME = 300_000_000  # ns from a loss of commands, a stop or a fault until the arm must be at rest
_STAMP_ONLY = {  # nodes and topics: the node reads the stamp on arrival, the content later or never
    *((name, "joint_states") for name in ("episode", "approach", "post_contact")),
    ("sim_bridge", "target_pose"),
}
NEXT_PHASES = {
    IDLE: {PRE, FAULT},
    PRE: {APPROACH, FAILED, FAULT},
    APPROACH: {POST, FAILED, FAULT},
    POST: {SUCCEEDED, FAILED, FAULT, PRE},
    SUCCEEDED: {PRE, FAULT},
    FAILED: {PRE, FAULT},
    FAULT: {IDLE},
}


class Invariants:
    """Collects violations, at most one of each kind; find_node(name) returns the running node, or None.

    pushed_until, sensor_bad_until, keypoints_bad_until: ns until which the arm is pushed, its sensors are wrong, or keypoints are wrong;
    checks that depend on these pause until then. recover_requests: calls of `recover` since the backend stopped.
    """

    def __init__(
        self, domain: Task, clock: Scheduler, find_node: Callable[[str], Node | None], log: Callable[[str], None]
    ):
        self._domain, self._clock, self._find_node, self._log = domain, clock, find_node, log
        self.steps = self._since_episode = 0  # in total; since `episode` ended
        self._stepped: deque[int] = deque(maxlen=1000)  # ns
        self.violations: dict[str, str] = {}
        self.phases: list[PhaseState] = []
        self.pushed_until = self.recover_requests = self.keypoints_bad_until = 0
        self.sensor_bad_until = 0
        self._torque = np.zeros(7)
        self._state, self._held_since = None, None
        self._goal, self.is_acknowledged, self._is_started = "", False, False

    def violate(self, kind: str, text: str) -> None:
        """Store and log the first violation of a kind."""
        if kind not in self.violations:
            self.violations[kind] = text
            self._log(f"VIOLATION {kind}: {text} (guaranteed by {GUARANTEES[kind]})")

    # The arm

    def on_start(self) -> None:
        """Handle the start of a new backend."""
        self._state = None
        self.on_reset()

    def on_reset(self) -> None:
        """Handle a reset of the arm to a new task."""
        self._torque, self._held_since = np.zeros(7), None
        self.is_acknowledged = self._is_started = False

    def count_step(self) -> None:
        """Count one control period of the arm."""
        self.steps += 1
        self._stepped.append(self._clock.now)

    @property
    def period(self) -> float:
        """Median time between the last thousand steps of the arm, ms of the clock; 2 in real time."""
        return float(np.median(np.diff(self._stepped))) * 1e-6 if len(self._stepped) > 1 else 2.0

    def on_step(self, torque: np.ndarray, q: np.ndarray, dq: np.ndarray) -> None:
        """Check one period: applied torque (7,) Nm; true joints q (9,) rad, m and velocities dq (9,) rad/s, m/s after it."""
        if not np.isfinite(torque).all() or (np.abs(torque) > LIMITS.torque + 1e-9).any():
            self.violate("torque", f"applied {torque}")
        if (np.abs(torque - self._torque) > LIMITS.torque_step + 1e-9).any():
            self.violate("torque", f"torque changed by {np.abs(torque - self._torque).max():.3f} Nm in a period")
        self._torque = torque.copy()
        self.count_step()
        if (bridge := self._find_node("sim_bridge")) is None:
            return
        is_undisturbed = self._clock.now > self.pushed_until
        q, dq = q[:7], dq[:7]
        outside = (q < LIMITS.position_lower) | (q > LIMITS.position_upper) | (np.abs(dq) > LIMITS.velocity)
        if is_undisturbed and self._clock.now > self.sensor_bad_until and outside.any():
            self.violate("range", f"joints at {q.round(3)} rad, {dq.round(2)} rad/s")
        if bridge._simulation.reflex and bridge._filter.watchdog.may_move and not self.recover_requests:
            self.violate("reflex", f"{bridge._simulation.reflex}, and the arm is {bridge._filter.state}")
        speed = float(np.abs(dq).max())
        self._check_state(bridge, speed, is_undisturbed)
        is_counted = self._find_node("episode") is None and is_undisturbed
        self._since_episode = self._since_episode + 1 if is_counted else 0
        if self._since_episode * LIMITS.period_ns > REST_TIME and speed > LIMITS.rest_speed:
            self.violate("rest", f"{speed:.2f} rad/s {self._since_episode * LIMITS.period} s after the end of episode")
        is_allowed = self.is_acknowledged and self._is_started
        # A controller that reads a wrong angle moves the arm as long as it does.
        is_sensed = self._clock.now > self.sensor_bad_until
        if speed > LIMITS.rest_speed and is_undisturbed and is_sensed and not is_allowed:
            self.violate(
                "motion", f"{speed:.2f} rad/s, goal acknowledged: {self.is_acknowledged}, started: {self._is_started}"
            )

    def _check_state(self, bridge, speed: float, is_undisturbed: bool) -> None:
        """Check that only `recover` ends a stop or a fault, and that the arm comes to rest in time."""
        state, stamp = bridge._filter.state, bridge._simulation.stamp
        held = (State.STOPPED, State.FAULT)
        if self._state in held and state not in held and not self.recover_requests:
            self.violate("recover", f"{self._state} became {state} without recover")
        if state not in held:
            if self._state in held:  # the arm moves up to 0.1 rad to the target of the first command (graph.md)
                self._since_episode = 0
            self.recover_requests = 0
        self._state = state
        lost = bridge._filter.watchdog._last if state in (State.MOVING, State.HOLDING) else None
        if state in held:
            self._held_since = stamp if self._held_since is None else self._held_since
            lost = self._held_since
        else:
            self._held_since = None
        if not is_undisturbed:
            self._held_since = stamp if state in held else None
        elif lost is not None and stamp - lost > REST_TIME and speed > LIMITS.rest_speed:
            self.violate("rest", f"{speed:.2f} rad/s {(stamp - lost) / 1e6:.0f} ms after it was {state}")

    # Messages

    def on_goal(self, data: bytes) -> None:
        """Read a message on `goal_pose`."""
        self._goal = goal_text(deserialize_message(data, PoseStamped))

    def on_diagnostics(self, data: bytes) -> None:
        """Read a message on `diagnostics`."""
        for status in deserialize_message(data, DiagnosticArray).status:
            if status.name == "/episode":
                values = {pair.key: pair.value for pair in status.values}
                self.is_acknowledged |= bool(self._goal) and values.get(GOAL) == self._goal

    def on_phase(self, publisher, data: bytes) -> None:
        """Check a message on `episode/phase`."""
        try:
            state = phase_state(deserialize_message(data, DiagnosticArray))
        except BadMessage:
            return
        before = getattr(publisher, "last_phase", None)
        is_first = before is None
        publisher.last_phase = state.phase
        if state.phase not in ({IDLE} if is_first else NEXT_PHASES[before]):
            self.violate("phases", f"{before or 'the start of episode'} was followed by {state.phase}")
        if state.phase in ACTIVE:
            self._is_started = True
        self.phases.append(state)
        self._log(f"phase {state}")
        if state.phase == SUCCEEDED:
            self._check_success()

    def on_accepted_invalid(self, subscription) -> None:
        """Handle a message with NaN that a node accepted and did not count."""
        name, topic = subscription.process.spec.name, subscription.topic_name.lstrip("/")
        if (name, topic) in _STAMP_ONLY or name == "recorder":
            return
        self.violate("refusals", f"{name} accepted an invalid {topic}")

    def _check_success(self) -> None:
        bridge, core = self._find_node("sim_bridge"), self._find_node("episode")._episode
        if not is_success(self._domain, core.distance, core.angle):
            self.violate("success", f"declared at {core.distance:.4f} m, {core.angle:.3f} rad by the estimate")
        if bridge is None or self._clock.now < self.keypoints_bad_until or not self.is_acknowledged:
            return
        goal, now = bridge._simulation.task.goal, bridge._simulation.object_pose()
        distance, angle = pose_error(now.position, now.quaternion, goal.position, goal.quaternion)
        if not is_success(self._domain, distance / 1.5, angle / 1.5):
            self.violate("success", f"declared, but the object is {distance:.4f} m, {angle:.3f} rad from its goal")

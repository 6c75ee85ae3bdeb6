"""The conductor: a node of the demo and the evaluation that resets, starts and follows episodes.

It is the only one besides the recorder that subscribes to the true object pose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2

from np_control.force_watch import ForceFigures, read_figures
from np_description.contact.depths import DepthHistogram
from np_description.contact.penetration import Penetration
from np_description.domains import Pose, Task
from np_description.limit_share import limit_shares
from np_description.message_arrays import joint_state_arrays, pose_arrays, stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.phases import PhaseState, first_end
from np_record.bulk import read_joint_rows
from np_record.cdr import header_stamp
from np_record.outcome import Outcome, score_outcome
from np_ros import qos
from np_ros.client.supervised_client import SERVICE_TIMEOUT, GraphError, SupervisedGraphClient
from np_ros.phases import phase_state
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor

_QUIET = 0.1  # s
_DIAGNOSED = 1.5  # s of wall time, in which diagnostics come at least once
_FORCE = "external_force"  # key of the backend's figures of an episode
_KEPT = 50  # states that wait for the pose of their stamp


class EpisodeRunner(SupervisedGraphClient):
    """Runs episodes on the graph of a supervisor, whose robot the node `backend` owns.

    on_phase(phase, s of simulated time since the reset) is called at every change, on_tick(s) at every policy tick.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        domain: Task,
        *,
        lockstep: bool = True,
        backend: str = "sim_bridge",
        on_phase: Callable[[PhaseState, float], None] = lambda *_: None,
        on_tick: Callable[[float], None] = lambda _: None,
    ):
        super().__init__(supervisor, "conductor")
        self._domain, self._lockstep = domain, lockstep
        self._backend = backend
        self._on_phase, self._on_tick = on_phase, on_tick
        self._phases: list[PhaseState] = []
        self._poses: list[tuple[int, Pose]] = []
        self._goal: tuple[int, Pose] | None = None
        self._in_force = -1  # stamp of the goal that `episode` has
        self._now = 0
        self._penetration, self._tally = Penetration(domain), DepthHistogram()
        self._heard: list[bytes] = []  # every state of the episode
        self._states: dict[int, bytes] = {}
        self._waiting: dict[int, Pose] = {}
        self._backend_says: dict[str, str] = {}  # values of its newest diagnostics
        node, stream = self._node, qos.LOCKSTEP if lockstep else qos.REALTIME_SUBSCRIBER
        # Each of several in a row: contacts are counted by them.
        node.create_subscription(DiagnosticArray, "episode/phase", self._receive_phase, qos.RECORDER_LATCHED)
        node.create_subscription(PoseStamped, "goal_pose", self._receive_goal, qos.LATCHED)
        node.create_subscription(PointCloud2, "goal_keypoints", self._receive_goal_keypoints, qos.LATCHED)
        node.create_subscription(PoseStamped, "object_pose", self._receive_pose, stream)
        node.create_subscription(DiagnosticArray, "episode/tick", self._receive_tick, stream)
        node.create_subscription(DiagnosticArray, "diagnostics", self._receive_diagnostics, qos.RECORDER)
        node.create_subscription(JointState, "joint_states", self._receive_state, stream, raw=True)

    def listen(self, seconds: float) -> None:
        """Let so much wall time pass. Raises NodeDied."""
        deadline = time.monotonic() + seconds
        self._wait(lambda: time.monotonic() > deadline, 2 * seconds + SERVICE_TIMEOUT, "the end of a measurement")

    def wait_until_ready(
        self,
        specs: Sequence[NodeSpec],
        timeout: float = 120.0,
        services: Sequence[str] | None = None,
    ) -> None:
        """Wait until all nodes are up and matched, and the services are there; None: those of episodes.

        Raises NodeDied or TimeoutError.
        """
        if services is None:
            services = (f"{self._backend}/reset", "episode/start")
        names = {spec.name for spec in specs}
        self._wait(lambda: not self._links.missing(names), timeout, f"diagnostics of {', '.join(sorted(names))}")
        for service in services:
            self.find(service, timeout)
        self._wait(lambda: self._links.are_complete(names), timeout, "every publisher to find its subscribers")

    def start_recording(self) -> str:
        """Open the next bag; its path. Raises GraphError with the recorder's reason."""
        deadline = time.monotonic() + SERVICE_TIMEOUT
        while not (answer := self.call("recorder/start")).success:
            if time.monotonic() > deadline or "publisher" not in answer.message:
                raise GraphError(f"recorder/start: expected success, got: {answer.message}")
            self._spin_once()
        return answer.message

    def run_episode(self, timeout: float = 600.0, until: float = float("inf")) -> Outcome:
        """Reset, start, and follow one episode to its end; how it ended by the truth.

        until: time.monotonic() s at which it is stopped on request, if it has not ended. Raises GraphError,
        NodeDied, or TimeoutError when no end has come within `timeout` s of wall time.
        """
        before = self._goal[0] if self._goal else -1
        self._succeed(f"{self._backend}/reset")
        self._wait(
            lambda: self._goal is not None and self._goal[0] > before,
            SERVICE_TIMEOUT,
            "goal_pose after the reset",
        )
        began, goal = self._goal
        # A start that came before would begin with the goal of before.
        self._wait(lambda: self._in_force == began, SERVICE_TIMEOUT, "goal_keypoints after the reset")
        self._phases.clear()
        self._tally = DepthHistogram()
        self._heard.clear()
        self._poses = [item for item in self._poses if item[0] >= began]
        self._succeed("episode/start")
        self._wait(lambda: self._has_ended or time.monotonic() > until, timeout, "the end of the episode")
        if not self._has_ended:
            self.call("episode/stop")  # refused where the end came in between
            self._wait(lambda: self._has_ended, SERVICE_TIMEOUT, "the end of the episode")
        self._wait(lambda: self._poses, SERVICE_TIMEOUT, "object_pose")
        self._hear_out()
        self._hear_backend()
        ended, pose = self._poses[-1]
        return score_outcome(self._domain, self._phases, pose, goal, (ended - began) / 1e9)

    @property
    def depths(self) -> DepthHistogram:
        """Penetration depths of the last episode, at every true pose of the object."""
        return self._tally

    @property
    def limit_shares(self) -> np.ndarray:
        """The largest shares (3, 7) of the arm's limits that its joints came to in the last episode (np_description.limit_share)."""
        values = read_joint_rows(self._heard, JOINT_NAMES)
        return limit_shares(*values.transpose(1, 0, 2)).max(1, initial=0.0)

    @property
    def force(self) -> ForceFigures | None:
        """The external force of the last episode; None where the backend does not estimate it."""
        text = self._backend_says.get(_FORCE)
        return read_figures(text) if text else None

    def recover(self, timeout: float = SERVICE_TIMEOUT) -> None:
        """Make a backend that has stopped follow commands again, once the arm rests. Raises GraphError."""
        deadline = time.monotonic() + timeout
        while not (answer := self.call(f"{self._backend}/recover")).success:
            if time.monotonic() > deadline:
                raise GraphError(f"{self._backend}/recover: expected success, got: {answer.message}")
            self._spin_once()

    @property
    def _has_ended(self) -> bool:
        return first_end(self._phases) is not None

    def _hear_out(self) -> None:
        """Lockstep: time rests at an episode's end; take what came before, however much, the last pose above all."""
        heard = -1
        while self._lockstep and len(self._poses) > heard:
            heard = len(self._poses)
            self.listen(_QUIET)

    def _hear_backend(self) -> None:
        """Wait for diagnostics that are as late as the last pose, of a backend that estimates the external force."""
        if _FORCE not in self._backend_says:
            return
        ended, deadline = self._poses[-1][0], time.monotonic() + _DIAGNOSED
        self._wait(
            lambda: int(self._backend_says.get("stamp", 0)) >= ended or time.monotonic() > deadline,
            SERVICE_TIMEOUT,
            f"diagnostics of {self._backend}",
        )

    def _receive_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.lstrip("/") == self._backend:
                self._backend_says = {value.key: value.value for value in status.values}

    def _receive_phase(self, message: DiagnosticArray) -> None:
        self._phases.append(phase_state(message))
        self._on_phase(self._phases[-1], self._elapsed)

    def _receive_goal(self, message: PoseStamped) -> None:
        self._goal = stamp_nanoseconds(message.header.stamp), Pose(*pose_arrays(message, BASE_FRAME))

    def _receive_goal_keypoints(self, message: PointCloud2) -> None:
        self._in_force = stamp_nanoseconds(message.header.stamp)

    def _receive_pose(self, message: PoseStamped) -> None:
        self._now = stamp_nanoseconds(message.header.stamp)
        self._poses.append((self._now, Pose(*pose_arrays(message, BASE_FRAME))))
        self._waiting[self._now] = self._poses[-1][1]
        self._pair()

    def _receive_state(self, data: bytes) -> None:
        self._heard.append(data)
        self._states[header_stamp(data)] = data  # read where a pose has its stamp: one in some fifteen
        while len(self._states) > _KEPT:
            del self._states[next(iter(self._states))]
        if self._waiting:
            self._pair()

    def _pair(self) -> None:
        for stamp in [stamp for stamp in self._waiting if stamp in self._states]:
            joints = joint_state_arrays(deserialize_message(self._states[stamp], JointState), STATE_NAMES)[0]
            self._tally.add(self._penetration.depths(joints, self._waiting.pop(stamp)))
        while len(self._waiting) > _KEPT:
            del self._waiting[next(iter(self._waiting))]

    def _receive_tick(self, message: DiagnosticArray) -> None:
        self._now = stamp_nanoseconds(message.header.stamp)
        self._on_tick(self._elapsed)

    @property
    def _elapsed(self) -> float:
        return (self._now - self._goal[0]) / 1e9 if self._goal else 0.0

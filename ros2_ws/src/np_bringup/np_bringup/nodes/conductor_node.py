"""The conductor: a node of the demo and the evaluation that resets, starts and follows episodes.

It runs in the process of the command, next to the supervisor that owns the other nodes, and is the only one
besides the recorder to hear the true object pose.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence

import rclpy
from geometry_msgs.msg import PoseStamped
from np_description.domains import Domain, Pose
from np_description.panda import BASE_FRAME
from np_ros import qos
from np_ros.messages import pose_arrays, stamp_nanoseconds
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from np_bringup.contract import END_PHASES, split_phase
from np_bringup.episode import Outcome, score
from np_bringup.graph import NodeSpec
from np_bringup.nodes.links import Links
from np_bringup.supervisor import Supervisor

_SPIN = 0.05  # s
_QUIET = 0.1  # s
_SERVICE_TIMEOUT = 60.0  # s of wall time


class GraphError(RuntimeError):
    """The graph did not do what an episode needs; the text says what was asked and what came."""


class Conductor:
    """Runs episodes on the graph of a supervisor, whose robot the node `backend` owns.

    on_phase(phase, reason, s of simulated time since the reset) is told every change, on_tick(s) every
    policy tick.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        domain: Domain,
        *,
        lockstep: bool = True,
        backend: str = "sim_bridge",
        on_phase: Callable[[str, str, float], None] = lambda *_: None,
        on_tick: Callable[[float], None] = lambda _: None,
    ):
        self._supervisor, self._domain, self._lockstep = supervisor, domain, lockstep
        self._backend = backend
        self._on_phase, self._on_tick = on_phase, on_tick
        os.environ.update(supervisor.environment)
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=supervisor.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node("conductor", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._links = Links(self._node)
        self._clients: dict[str, object] = {}
        self._phases: list[tuple[str, str]] = []
        self._poses: list[tuple[int, Pose]] = []
        self._goal: tuple[int, Pose] | None = None
        self._now = 0
        node, stream = self._node, qos.LOCKSTEP if lockstep else qos.REALTIME_SUBSCRIBER
        node.create_subscription(String, "phase", self._receive_phase, qos.LATCHED)
        node.create_subscription(PoseStamped, "goal_pose", self._receive_goal, qos.LATCHED)
        node.create_subscription(PoseStamped, "object_pose", self._receive_pose, stream)
        node.create_subscription(Header, "tick", self._receive_tick, stream)

    def __enter__(self) -> Conductor:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=0)
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def listen(self, seconds: float) -> None:
        """Let so much wall time pass. Raises NodeDied."""
        deadline = time.monotonic() + seconds
        self._wait(
            lambda: time.monotonic() > deadline, 2 * seconds + _SERVICE_TIMEOUT, "the end of a measurement"
        )

    def wait_until_ready(
        self,
        specs: Sequence[NodeSpec],
        timeout: float = 120.0,
        services: Sequence[str] | None = None,
    ) -> None:
        """Until all nodes are up and matched, and the services, those of episodes where none are named, are there.

        Raises NodeDied or TimeoutError.
        """
        if services is None:
            services = (f"{self._backend}/reset", "episode/start")
        names = {spec.name for spec in specs}
        self._wait(
            lambda: not self._links.missing(names), timeout, f"diagnostics of {', '.join(sorted(names))}"
        )
        for service in services:
            self._wait(self._client(service).service_is_ready, timeout, f"the service {service}")
        self._wait(
            lambda: self._links.are_complete(names), timeout, "every publisher to find its subscribers"
        )

    def start_recording(self, timeout: float = _SERVICE_TIMEOUT) -> str:
        """Open the next bag; its path. Raises GraphError with the recorder's reason."""
        deadline = time.monotonic() + timeout
        while not (answer := self.call("recorder/start")).success:
            if time.monotonic() > deadline or "publisher" not in answer.message:
                raise GraphError(f"recorder/start: expected success, got: {answer.message}")
            self._spin_once()
        return answer.message

    def stop_recording(self) -> dict:
        """Close the bag; what the recorder says about it."""
        answer = self.call("recorder/stop")
        if not answer.success:
            raise GraphError(f"recorder/stop: expected success, got: {answer.message}")
        return json.loads(answer.message)

    def run_episode(self, timeout: float = 600.0, until: float = float("inf")) -> Outcome:
        """Reset, start, and follow one episode to its end; how it ended by the truth.

        until: time.monotonic() s at which it is stopped on request, if it has not ended. Raises GraphError,
        NodeDied, or TimeoutError when no end has come within `timeout` s of wall time.
        """
        before = self._goal[0] if self._goal else -1
        self._succeed(f"{self._backend}/reset")
        self._wait(
            lambda: self._goal is not None and self._goal[0] > before,
            _SERVICE_TIMEOUT,
            "goal_pose after the reset",
        )
        began, goal = self._goal
        self._phases.clear()
        self._poses = [item for item in self._poses if item[0] >= began]
        self._succeed("episode/start")
        self._wait(lambda: self._has_ended or time.monotonic() > until, timeout, "the end of the episode")
        if not self._has_ended:
            self.call("episode/stop")  # refused where the end came in between
            self._wait(lambda: self._has_ended, _SERVICE_TIMEOUT, "the end of the episode")
        self._wait(lambda: self._poses, _SERVICE_TIMEOUT, "object_pose")
        self._hear_out()
        declared, reason = self._phases[-1]
        ended, pose = self._poses[-1]
        return score(self._domain, declared, reason, pose, goal, (ended - began) / 1e9)

    def recover(self, timeout: float = _SERVICE_TIMEOUT) -> None:
        """Make a backend that has stopped follow commands again, once the arm rests. Raises GraphError."""
        deadline = time.monotonic() + timeout
        while not (answer := self.call(f"{self._backend}/recover")).success:
            if time.monotonic() > deadline:
                raise GraphError(f"{self._backend}/recover: expected success, got: {answer.message}")
            self._spin_once()

    @property
    def _has_ended(self) -> bool:
        return bool(self._phases) and self._phases[-1][0] in END_PHASES

    def _hear_out(self) -> None:
        """Lockstep: time rests at an episode's end; take what came before, the last pose above all."""
        deadline = time.monotonic() + (_QUIET if self._lockstep else 0.0)
        while time.monotonic() < deadline:
            self._spin_once()

    def _receive_phase(self, message: String) -> None:
        phase, reason = split_phase(message.data)
        self._phases.append((phase, reason))
        self._on_phase(phase, reason, self._elapsed)

    def _receive_goal(self, message: PoseStamped) -> None:
        self._goal = stamp_nanoseconds(message.header.stamp), Pose(*pose_arrays(message, BASE_FRAME))

    def _receive_pose(self, message: PoseStamped) -> None:
        self._now = stamp_nanoseconds(message.header.stamp)
        self._poses.append((self._now, Pose(*pose_arrays(message, BASE_FRAME))))

    def _receive_tick(self, message: Header) -> None:
        self._now = stamp_nanoseconds(message.stamp)
        self._on_tick(self._elapsed)

    @property
    def _elapsed(self) -> float:
        return (self._now - self._goal[0]) / 1e9 if self._goal else 0.0

    def _client(self, service: str):
        if service not in self._clients:
            self._clients[service] = self._node.create_client(Trigger, service)
        return self._clients[service]

    def call(self, service: str) -> Trigger.Response:
        """The response of a Trigger service. Raises TimeoutError or NodeDied."""
        client = self._client(service)
        self._wait(client.service_is_ready, _SERVICE_TIMEOUT, f"the service {service}")
        future = client.call_async(Trigger.Request())
        self._wait(future.done, _SERVICE_TIMEOUT, f"an answer of {service}")
        return future.result()

    def _succeed(self, service: str) -> None:
        answer = self.call(service)
        if not answer.success:
            raise GraphError(f"{service}: expected success, got: {answer.message}")

    def _wait(self, condition: Callable[[], object], timeout: float, what: str) -> None:
        def spun() -> bool:
            if condition():
                return True
            self._spin_once()
            return bool(condition())

        self._supervisor.wait(spun, timeout, what)

    def _spin_once(self) -> None:
        self._executor.spin_once(_SPIN)

"""Sends the excitation suite, or the task suite, to an arm: what the episode node is to a task, this is to an experiment.

It stands where `episode` and `approach` stand (docs/reference/graph.md): phase `excite`, ticks, one joint_trajectory
with gains for each segment. The controller follows, the backend guards, the recorder records.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState, PointCloud2
from sim2real.excitation.contact_suite.monitor import OutOfPicture, SuiteMonitor
from sim2real.excitation.contact_suite.suite import SuiteState, task_suite
from sim2real.excitation.suite import TICK_NS, Segment, end_stamp, make_suite, schedule_starts
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_control.safety import LIMITS
from np_description.camera import CAMERA, Camera
from np_description.domains import Task
from np_description.message_arrays import BadMessage, joint_state_arrays, keypoints_array, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import EXCITE, IDLE, PhaseState
from np_ros import qos
from np_ros.client.supervised_client import GraphError, SupervisedGraphClient
from np_ros.messages import gains_message, trajectory_message
from np_ros.phases import PhasePublisher
from np_ros.processes.supervisor import Supervisor

READY_TIMEOUT = 120.0  # s of wall time
PROGRESS_EVERY = 4.0  # s between two lines of progress while it waits
GAINS_AHEAD = TICK_NS  # ns by which gains go before their trajectory in real time
WITNESSED_NS = 20_000_000  # ns between states at which a task's experiment is watched
SILENCE = 20.0  # s of wall time without a state
FAREWELL = 1.0  # s at most, until every subscriber has the last phase
# A busy host makes single commands late: the backend's watchdog judges that, and the recording shows it.
PASSING = ("refused_late", "refused_order", "refused_future")


class Exciter(SupervisedGraphClient):
    """Runs a plan on the graph of a supervisor, which watches the processes that it has started.

    lockstep: whether time waits for our ticks. on_segment(name, number, count) is called at each start.
    """

    def __init__(
        self, supervisor: Supervisor, *, lockstep: bool, on_segment: Callable[[str, int, int], None] = lambda *_: None
    ):
        super().__init__(supervisor, "excite")
        self._lockstep, self._on_segment = lockstep, on_segment
        node = self._node
        stream = qos.publisher(lockstep)
        self._gains = node.create_publisher(Float64MultiArray, "target_gains", stream)
        self._trajectory = node.create_publisher(JointTrajectory, "joint_trajectory", qos.EVENT)
        self._phases = PhasePublisher(node, lockstep=lockstep)
        node.create_subscription(JointState, "joint_states", self._receive_state, qos.subscriber(lockstep))
        node.create_subscription(PointCloud2, "keypoints", self._receive_keypoints, qos.subscriber(lockstep))
        node.create_subscription(DiagnosticArray, "diagnostics", self._receive_diagnostics, qos.RECORDER)
        self._witness: SuiteMonitor | None = None  # of a task: what is seen and felt
        self._state: tuple[int, np.ndarray] | None = None
        self._states = 0  # received
        self._heard = time.monotonic()
        self._plan: list[Segment] = []
        self._starts: list[int] = []
        self._end: int | None = None
        self._sent = self._gains_sent = 0  # segments
        self._phase = PhaseState(IDLE)
        self._ticked = -1
        self._problem = ""
        self._refused: dict[tuple[str, str], int] = {}

    def wait_until_ready(
        self, names: set[str], arm_timeout: float = READY_TIMEOUT, show: Callable[[str], None] = lambda _: None
    ) -> None:
        """Wait until arm and controller are found, the named nodes are up and all are matched.

        arm_timeout: s for each of arm and controller; `show` is called every few seconds with what is still missing. Raises
        NodeDied, TimeoutError, or GraphError for joint states of another arm.
        """
        domain = self._supervisor.domain_id
        mode = "lockstep" if self._lockstep else "realtime"
        self._wait_aloud(
            lambda: self._state is not None,
            arm_timeout,
            f"joint_states of a backend in ROS domain {domain}, mode {mode}",
            show,
        )
        for publisher in (self._trajectory, self._gains):
            self._wait_aloud(
                lambda: publisher.get_subscription_count() > 0,
                arm_timeout,
                f"a controller that subscribes to {publisher.topic_name} in ROS domain {domain}",
                show,
            )
        self._wait_aloud(
            lambda: self._links.are_complete(names),
            READY_TIMEOUT,
            f"{', '.join(sorted(names))} matched with everyone",
            show,
        )
        # Lockstep repeats its first state until we tick. What went with the one we have may have been sent before the
        # recorder had subscribed; the one after the next was certainly sent after.
        heard = self._states
        self._wait(lambda: self._states >= heard + 2, READY_TIMEOUT, "joint_states, again")

    def run(self, only: Sequence[str] = ()) -> list[str]:
        """Send the named experiments, from where the arm is; the segments sent.

        Raises GraphError where the backend stops, a trajectory is refused or the states cease; NodeDied.
        """
        with self._at_rest_afterwards():
            return self._lead(make_suite(only, start=self._state[1]))

    def run_task(self, domain: Task, only: Sequence[str] = (), camera: Camera = CAMERA) -> list[str]:
        """Send the task suite's experiments, or some families of it, each planned once the one before is over; the segments sent. It ends
        where an experiment has moved the object out of the picture.

        Raises as `run` does; GraphError as well where the object is not seen at first, no pose explains it, or the hand presses harder
        than it may.
        """
        self._witness, sent = SuiteMonitor(domain, camera), []
        with self._at_rest_afterwards():
            plans = task_suite(domain, self._situation(self._state[0]), only, camera)
            plan = next(plans, None)
            while plan is not None:
                sent += self._lead(plan)
                try:
                    plan = plans.send(self._situation(self._end))
                except StopIteration:
                    plan = None
                except GraphError as error:
                    if not isinstance(error.__cause__, OutOfPicture):
                        raise
                    print(f"excite: {error}; the suite ends here", file=sys.stderr)
                    plan = None
        return sent

    @contextmanager
    def _at_rest_afterwards(self) -> Iterator[None]:
        try:
            yield
        finally:  # whatever ends it, the arm goes no further
            self._enter(PhaseState(IDLE))
            self._phases.wait_until_heard(FAREWELL)

    def _lead(self, plan: list[Segment]) -> list[str]:
        """Send a plan, from where the arm is; the segments sent."""
        begin = -(-self._state[0] // TICK_NS) * TICK_NS
        self._plan, self._sent, self._gains_sent = plan, 0, 0
        self._starts, self._end = schedule_starts(plan, begin), end_stamp(plan, begin)
        self._heard = time.monotonic()
        self._advance()
        self._follow(lambda: self._state[0] >= self._end, "the end of the experiment")
        return [segment.name for segment in plan]

    def _situation(self, since: int) -> SuiteState:
        """What the next experiment is planned from, once the object has been seen at `since` ns or later."""
        self._heard = time.monotonic()
        self._wait(lambda: self._witness.has_image(since), READY_TIMEOUT, "keypoints of the object")
        try:
            return self._witness.state(self._state[1])
        except ValueError as error:
            raise GraphError(f"expected the object in the picture: {error}") from error

    def _wait_aloud(
        self, condition: Callable[[], bool], timeout: float, what: str, show: Callable[[str], None]
    ) -> None:
        begun = shown = time.monotonic()

        def holds() -> bool:
            nonlocal shown
            now = time.monotonic()
            if now - shown >= PROGRESS_EVERY:
                shown = now
                show(f"waiting for {what}: {now - begun:.0f} of {timeout:.0f} s")
            return condition()

        self._wait(holds, timeout, what)

    def _receive_state(self, message: JointState) -> None:
        try:
            position, velocity, effort = joint_state_arrays(message, STATE_NAMES)
        except BadMessage as error:
            names = "a backend keeps the names of docs/reference/graph.md, or stands behind the node joint_names"
            raise GraphError(f"joint_states: {error}; {names}") from error
        arm = slice(len(JOINT_NAMES))
        self._state = stamp_nanoseconds(message.header.stamp), position[arm]
        if self._witness is not None and self._state[0] % WITNESSED_NS == 0:
            self._problem = self._witness.check_contact(position[arm], velocity[arm], effort[arm]) or self._problem
        self._states += 1
        self._heard = time.monotonic()
        self._advance()

    def _advance(self) -> None:
        """Publish what is due at the newest state."""
        stamp, position = self._state
        if self._end is None or stamp >= self._end:
            return
        if not self._lockstep:
            self._send_gains_ahead(stamp)
        if self._sent < len(self._plan) and stamp >= self._starts[self._sent]:
            self._send_segment(stamp, position)
        # In real time a busy machine misses states, also those of a tick: then the next one is it.
        if stamp % TICK_NS == 0 if self._lockstep else stamp // TICK_NS > self._ticked:
            self._ticked = stamp // TICK_NS
            self._phases.tick(stamp, self._phase)

    def _send_gains_ahead(self, stamp: int) -> None:
        """Real time: gains first, or the trajectory might overtake them on its own topic."""
        number = self._gains_sent
        if number == self._sent < len(self._plan) and stamp >= self._starts[number] - GAINS_AHEAD:
            self._gains.publish(gains_message(self._plan[number].gains))
            self._gains_sent += 1

    def _send_segment(self, stamp: int, position: np.ndarray) -> None:
        segment = self._plan[self._sent]
        error = np.abs(position - segment.positions[0])
        if (error > LIMITS.start_tolerance).any():
            i = int(error.argmax())
            raise GraphError(
                f"{segment.name}: expected {JOINT_NAMES[i]} at "
                f"{segment.positions[0][i]:.3f} rad, found it {error[i]:.3f} rad from there"
            )
        self._enter(PhaseState(EXCITE, experiment=segment.name))
        if self._lockstep:
            self._gains.publish(gains_message(segment.gains))
        self._trajectory.publish(
            trajectory_message(stamp, JOINT_NAMES, segment.times, segment.positions, segment.velocities)
        )
        self._sent += 1
        self._on_segment(segment.name, self._sent, len(self._plan))

    def _enter(self, state: PhaseState) -> None:
        self._phase = state
        self._phases.phase(state)

    def _receive_keypoints(self, message: PointCloud2) -> None:
        if self._witness is not None:
            try:
                self._witness.add_keypoints(stamp_nanoseconds(message.header.stamp), keypoints_array(message))
            except BadMessage as error:
                self._problem = f"keypoints: {error}"

    def _receive_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.level == DiagnosticStatus.ERROR:
                self._problem = f"{status.name.lstrip('/')}: {status.message}"
            for pair in status.values:
                key = status.name, pair.key
                if pair.key.startswith("refused_") and pair.key not in PASSING:
                    before = self._refused.setdefault(key, int(pair.value))
                    if self._end is not None and int(pair.value) > before:
                        last = next((v.value for v in status.values if v.key == "last_refusal"), "")
                        self._problem = f"{status.name}: {pair.key} {pair.value} {last}".rstrip()

    def _follow(self, condition: Callable[[], bool], what: str) -> None:
        """Spin until the condition holds: the arm must be well, and its states must keep coming."""

        def well() -> bool:
            if self._problem:
                raise GraphError(f"expected an arm and a graph that are well, got: {self._problem}")
            if time.monotonic() - self._heard > SILENCE:
                raise GraphError(f"expected joint_states, none came for {SILENCE:g} s")
            return condition()

        self._wait(well, float("inf"), what)

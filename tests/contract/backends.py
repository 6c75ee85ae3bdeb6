"""The backends that the contract suite judges, and the harness that plays the rest of the graph against one.

To have another backend judged, add it to BACKENDS: the tests only use what docs/reference/graph.md promises. What a
command is differs (commands.py); what a backend owes its sender does not."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from commands import EFFORTS, PERIOD, TARGETS, Command, Commands, pushing, stay
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from np_ros import qos
from np_ros.messages import stamp_nanoseconds

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))

import simulated_robot  # noqa: E402

from np_physx_bridge import library  # noqa: E402

__all__ = ["BACKENDS", "PERIOD", "Harness", "pushing", "silent", "stay"]


@contextmanager
def nothing() -> Iterator[dict]:
    """What a backend needs that brings everything itself."""
    yield {}


@contextmanager
def robot() -> Iterator[dict]:
    """A robot for a driver, simulated behind its network protocol."""
    with simulated_robot.simulated_robot() as (_, parameters):
        yield parameters


@dataclass(frozen=True)
class Backend:
    """One backend: its executable, the parameters of each mode, what it can do besides moving the arm.

    commands: what moves it; has_tasks: it draws tasks; has_camera: it gives images; can_pause: its time can
    stand still. needs: what must run before it, giving further parameters. missing: why it cannot be started
    here, or empty."""

    package: str
    name: str
    modes: dict[str, dict] = field(default_factory=dict)
    commands: Commands = EFFORTS
    has_tasks: bool = False
    has_camera: bool = False
    can_pause: bool = False
    needs: Callable[[], AbstractContextManager[dict]] = nothing
    missing: str = ""


BACKENDS = {
    "sim_bridge": Backend(
        "np_sim_bridge",
        "sim_bridge",
        has_tasks=True,
        has_camera=True,
        can_pause=True,
        modes={
            "lockstep": {"mode": "lockstep", "tick_barrier": False, "camera": False},
            "realtime": {"mode": "realtime", "camera": False},
        },
    ),
    "physx_bridge": Backend(
        "np_physx_bridge",
        "physx_bridge",
        has_tasks=True,
        has_camera=True,
        can_pause=True,
        modes={
            "lockstep": {"mode": "lockstep", "tick_barrier": False, "camera": False},
            "realtime": {"mode": "realtime", "camera": False},
        },
        missing=library.missing(),
    ),
    "minimal_backend": Backend("examples", "minimal_backend", modes={"realtime": {}}),
    "franka_driver": Backend(
        "np_franka", "franka_driver", modes={"realtime": {}}, needs=robot, missing=simulated_robot.missing()
    ),
    "franka_driver_onboard": Backend(
        "np_franka",
        "franka_driver",
        modes={"realtime": {"control": "onboard"}},
        commands=TARGETS,
        needs=robot,
        missing=simulated_robot.missing(),
    ),
}


def silent(state: JointState) -> None:
    """A controller that does not answer."""


class Harness:
    """A backend as a process, with the test as its controller.

    `answer(state)` gives the command for a state, or None for silence; change it at will. It is asked as
    often as the backend's kind of command is sent. `states` are all states received; `status`, `level`,
    `message` the newest of the backend's diagnostics, `said` the watchdog's state in each of them."""

    def __init__(self, graph, probe, backend: Backend, mode: str, **parameters):
        self.graph, self.probe, self.backend = graph, probe, backend
        self.commands = backend.commands
        self.answer: Callable[[JointState], Command | None] = silent
        self._answered = 0  # stamp ns
        self.status: dict[str, str] = {}
        self.level = b""
        self.message = ""
        self.said: list[str] = []
        self.states = probe.collect("joint_states", JointState, callback=self._on_state)
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT, callback=self._on_diagnostics)
        for topic, message_type in self.commands.sent.items():
            probe.advertise(topic, message_type)
        graph.run(backend.package, backend.name, {**backend.modes[mode], **parameters})
        self.wait(lambda: all(map(probe.matched, self.commands.sent)) and self.states, "the first state")

    def _on_state(self, state: JointState) -> None:
        if stamp_nanoseconds(state.header.stamp) - self._answered < self.commands.period:
            return
        command = self.answer(state)
        if command is not None:
            self._answered = stamp_nanoseconds(state.header.stamp)
            self.send(command)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == f"/{self.backend.name}":
                self.level, self.message = status.level, status.message
                self.status = {pair.key: pair.value for pair in status.values}
                self.said.append(self.status.get("state", ""))

    @property
    def stamp(self) -> int:
        """Stamp (ns) of the newest state."""
        return stamp_nanoseconds(self.states[-1].header.stamp)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Spin until the condition holds; where it does not, the backend's last words are told."""
        try:
            self.probe.wait_until(condition, what=what)
        except TimeoutError as error:
            raise TimeoutError(f"{error}; {self.backend.name} said: {self.message} {self.status}") from error

    def wait_state(self, *states: str) -> None:
        """Wait until the backend says that it is in one of these states."""
        self.wait(lambda: self.status.get("state") in states, f"state {' or '.join(states)}")

    def send(self, command: Command) -> None:
        """Publish one command: an effort command, or the messages of another by topic."""
        messages = {"effort_command": command} if isinstance(command, JointState) else command
        for topic, message in messages.items():
            self.probe.publish(topic, message)

    def send_until_refused(self, make: Callable[[JointState], Command], reason: str) -> None:
        """Answer states with `make(state)` until the count of refusals for `reason` has grown."""
        before = self.refused(reason)
        self.answer = make
        self.send(make(self.states[-1]))
        self.wait(lambda: self.refused(reason) > before, f"a refusal for {reason}")
        self.answer = silent

    def resume(self) -> None:
        """Stop the arm, and recover as soon as it is at rest: from here on it is ready."""
        assert self.call("stop").success
        while not (response := self.call("recover")).success:
            assert "still moves" in response.message, response.message
        self.wait_state("ready")

    def refused(self, reason: str) -> int:
        """How many commands were refused for this reason."""
        return int(self.status.get(f"refused_{reason}", 0))

    def call(self, service: str, request: bool | None = None):
        """Response of one of the backend's services."""
        return self.probe.call(f"{self.backend.name}/{service}", request)

    def follow(self, answer: Callable[[JointState], Command], until: Callable[[], object], what: str) -> None:
        """Answer every state, beginning with the newest, until the condition holds.

        The state at which it does so is not answered any more. Where a busy machine has kept us from
        answering for so long that the watchdog has rightly stopped the arm, recover and go on."""
        done = False

        def answer_until(state: JointState) -> Command | None:
            nonlocal done
            done = done or bool(until())
            return None if done else answer(state)

        self.answer = answer_until
        self.send(answer(self.states[-1]))

        def is_done() -> bool:
            if self.status.get("state") == "stopped" and "silence" in self.message and not (done or until()):
                self.call("recover")  # refused while the arm still moves
            return bool(done or until())

        self.wait(is_done, what)
        self.answer = silent

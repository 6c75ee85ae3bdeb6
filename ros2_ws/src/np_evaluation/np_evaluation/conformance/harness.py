"""The rest of the graph, played against one backend: the caller is its controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from np_description.message_arrays import stamp_nanoseconds
from np_evaluation.conformance.commands import EFFORTS, BackendCommands, Command
from np_ros import qos
from np_ros.client.graph_client import GraphClient


class BackendViolation(AssertionError):
    """The backend broke the contract; the text names what was expected and what came."""


def expect(kept: object, text: str) -> None:
    """Raises BackendViolation with `text` where `kept` does not hold."""
    if not kept:
        raise BackendViolation(text)


@dataclass(frozen=True)
class TestedBackend:
    """A backend and its abilities."""

    name: str
    """Of its node."""
    commands: BackendCommands = EFFORTS
    """The kind of command that moves it."""
    has_tasks: bool = False
    """Whether it draws tasks."""
    has_camera: bool = False
    """Whether it publishes images."""
    can_pause: bool = False
    """Whether its time can stand still."""


def silent(state: JointState) -> None:
    """A controller that sends no command."""


class Harness:
    """A backend with the caller as its controller; `meet` it before anything else.

    `answer(state)` returns the command for a state, or None for no command; change it at will. It is called at
    the rate of the backend's kind of command. `states` are all states received; `status`, `level`, `message`
    the newest of the backend's diagnostics, `watchdog_states` the watchdog's state in each of them.
    """

    def __init__(self, peer: GraphClient, backend: TestedBackend):
        self.peer, self.backend = peer, backend
        self.commands = backend.commands
        self.answer: Callable[[JointState], Command | None] = silent
        self._answered = 0  # stamp ns
        self.status: dict[str, str] = {}
        self.level = b""
        self.message = ""
        self.watchdog_states: list[str] = []
        self.states = peer.collect("joint_states", JointState, callback=self._on_state)
        peer.collect("diagnostics", DiagnosticArray, qos.EVENT, callback=self._on_diagnostics)
        for topic, message_type in self.commands.sent.items():
            peer.advertise(topic, message_type)

    def meet(self) -> None:
        """Wait until the backend subscribes to commands and its first state has come."""
        self.wait(lambda: all(map(self.peer.matched, self.commands.sent)) and self.states, "the first state")

    def prepare(self) -> None:
        """Bring the backend to the state after its start, and forget all messages."""
        self.answer = silent
        self.wait(lambda: self.status, "its diagnostics")
        if self.status.get("state") not in ("idle", "ready"):
            self.resume()
        for heard in self.peer.messages.values():
            heard.clear()
        self.watchdog_states.clear()
        self.wait(lambda: self.states, "a state")

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
                self.watchdog_states.append(self.status.get("state", ""))

    @property
    def stamp(self) -> int:
        """Stamp (ns) of the newest state."""
        return stamp_nanoseconds(self.states[-1].header.stamp)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Spin until the condition holds. Raises TimeoutError with the backend's newest diagnostics."""
        try:
            self.peer.wait_until(condition, what=what)
        except TimeoutError as error:
            raise TimeoutError(f"{error}; {self.backend.name} reported: {self.message} {self.status}") from error

    def wait_state(self, *states: str) -> None:
        """Wait until the backend reports one of these states."""
        self.wait(lambda: self.status.get("state") in states, f"state {' or '.join(states)}")

    def send(self, command: Command) -> None:
        """Publish one command: an effort command, or the messages of another by topic."""
        messages = {"effort_command": command} if isinstance(command, JointState) else command
        for topic, message in messages.items():
            self.peer.publish(topic, message)

    def send_until_refused(self, make: Callable[[JointState], Command], reason: str) -> None:
        """Send `make(state)` for every state until the count of refusals for `reason` has grown."""
        before = self.refused(reason)
        self.answer = make
        self.send(make(self.states[-1]))
        self.wait(lambda: self.refused(reason) > before, f"refused_{reason} to grow")
        self.answer = silent

    def resume(self) -> None:
        """Stop the arm, and recover as soon as it is at rest: from here on it is ready."""
        self.succeed("stop")
        while not (response := self.call("recover")).success:
            expect("still moves" in response.message, f"recover: expected success, got {response.message!r}")
        self.wait_state("ready")

    def refused(self, reason: str) -> int:
        """Number of commands refused for a reason."""
        return int(self.status.get(f"refused_{reason}", 0))

    def call(self, service: str, request: bool | None = None):
        """Response of one of the backend's services."""
        return self.peer.call(f"{self.backend.name}/{service}", request)

    def succeed(self, service: str, request: bool | None = None) -> None:
        """Call a service that has to be done."""
        response = self.call(service, request)
        expect(response.success, f"{service}: expected success, got {response.message!r}")

    def follow(self, answer: Callable[[JointState], Command], until: Callable[[], object], what: str) -> None:
        """Send a command for every state, beginning with the newest, until the condition holds.

        The state at which it holds gets no command. On a busy machine commands may come so late that the
        watchdog rightly stops the arm: then recover and go on.
        """
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

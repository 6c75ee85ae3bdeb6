"""Phase, reason and experiment as messages: `episode/tick`, `episode/phase`, `episode/heartbeat` and `approach/refusal`.

Each but the heartbeat is a diagnostic_msgs/DiagnosticArray with one status, whose documented keys (docs/reference/graph.md) carry
the content and whose message is for people. A type that every ROS 2 has: nothing has to be compiled to read it.
"""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String

from np_description.message_arrays import BadMessage
from np_description.phases import AT_REST, FAILED, FAULT, IDLE, PhaseState
from np_ros import qos
from np_ros.messages import header_message
from np_ros.node import create_steady_timer

EPISODE, APPROACH = "episode", "approach"
HEARTBEAT = "episode/heartbeat"
HEARTBEAT_PERIOD = 0.02  # s


def phase_message(state: PhaseState, stamp: int = 0) -> DiagnosticArray:
    """The message of `episode/tick`, at the stamp of the tick in ns, or of `episode/phase`, which has none."""
    level = DiagnosticStatus.ERROR if state.phase in (FAILED, FAULT) else DiagnosticStatus.OK
    return _message(stamp, EPISODE, level, str(state), state.values)


def phase_state(message: DiagnosticArray) -> PhaseState:
    """The phase in a message of `episode/tick` or `episode/phase`. Raises BadMessage (names, range)."""
    values = _values(message, EPISODE)
    try:
        return PhaseState.of(values)
    except ValueError as error:
        raise BadMessage("range", f"DiagnosticStatus '{EPISODE}': {error}") from error


def refusal_message(stamp: int, reason: str) -> DiagnosticArray:
    """The message of `approach/refusal`: why there is no plan for the keypoints of stamp ns."""
    return _message(stamp, APPROACH, DiagnosticStatus.ERROR, reason, {"reason": reason})


def refusal_reason(message: DiagnosticArray) -> str:
    """Why there is no plan. Raises BadMessage (names)."""
    values = _values(message, APPROACH)
    if "reason" not in values:
        raise BadMessage("names", f"DiagnosticStatus '{APPROACH}': expected the key reason, got {list(values)}")
    return values["reason"]


def heartbeat_phase(message: String) -> str:
    """The phase in force by a message of `episode/heartbeat`. Raises BadMessage (range)."""
    try:
        return PhaseState(message.data).phase
    except ValueError as error:
        raise BadMessage("range", f"{HEARTBEAT}: {error}") from error


class PhasePublisher:
    """Publishes ticks and phases for a node that owns the phases, `episode` or `excite`; in real time also heartbeats, while something is
    under way."""

    def __init__(self, node: Node, *, lockstep: bool):
        self._tick = node.create_publisher(DiagnosticArray, "episode/tick", qos.publisher(lockstep))
        self._phase = node.create_publisher(DiagnosticArray, "episode/phase", qos.LATCHED)
        self._in_force = IDLE
        if not lockstep:
            self._heartbeat = node.create_publisher(String, HEARTBEAT, qos.publisher(lockstep))
            create_steady_timer(node, HEARTBEAT_PERIOD, self._beat)

    def tick(self, stamp: int, state: PhaseState) -> None:
        """The policy tick of stamp ns, from which on `state` is in force."""
        self._tick.publish(phase_message(state, stamp))

    def phase(self, state: PhaseState) -> None:
        """`state` is in force from now on."""
        self._in_force = state.phase
        self._phase.publish(phase_message(state))

    def _beat(self) -> None:
        if self._in_force not in AT_REST:
            self._heartbeat.publish(String(data=self._in_force))

    def wait_until_heard(self, seconds: float) -> None:
        """Wait until every subscriber has the last phase, at most so many s."""
        self._phase.wait_for_all_acked(Duration(seconds=seconds))


def _message(stamp: int, name: str, level: bytes, text: str, values: Mapping[str, str]) -> DiagnosticArray:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    status = DiagnosticStatus(name=name, level=level, message=text, values=pairs)
    return DiagnosticArray(header=header_message(stamp), status=[status])


def _values(message: DiagnosticArray, name: str) -> dict[str, str]:
    """The keys of the only status, which has this name."""
    if (names := [status.name for status in message.status]) != [name]:
        raise BadMessage("names", f"DiagnosticArray: expected one status, '{name}', got {names}")
    pairs = message.status[0].values
    values = {pair.key: pair.value for pair in pairs}
    if len(values) != len(pairs):
        raise BadMessage(
            "names", f"DiagnosticStatus '{name}': expected each key once, got {[pair.key for pair in pairs]}"
        )
    return values

"""The phases in a bag, in the format of this release and of former ones. No ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from np_description.phases import EXCITE, PhaseState, split_reason
from np_record.bag import BagError, Message

PHASE_TOPICS = ("episode/phase", "phase")  # the newer first: where a bag has it, the other has the same phases


def read_phase(bag: str, message: Message) -> PhaseState:
    """The phase in a recorded message of `episode/phase`, `episode/tick` or the former `phase`; bag: its name.

    Raises BagError for a message that cannot be read or has no phase.
    """
    try:
        decoded = message.decode()
        if message.topic.name == "phase":
            return _former(decoded.data)
        return PhaseState.of({pair.key: pair.value for status in decoded.status for pair in status.values})
    except Exception as error:  # broken bytes end in any of a dozen types
        raise BagError(f"{bag}: {message.topic.name} at {message.stamp} ns: expected a phase, got: {error}") from error


def read_phase_changes(bag: str, messages: Mapping[str, Sequence[Message]]) -> list[tuple[int, PhaseState]]:
    """(stamp ns, phase) in order, of a bag's messages by topic: of the newer topic where it has both. Raises BagError."""
    topic = next((name for name in PHASE_TOPICS if messages.get(name)), None)
    return [(message.stamp, read_phase(bag, message)) for message in messages[topic]] if topic else []


def _former(text: str) -> PhaseState:
    """The phase in a String of former releases: "failed: post: timeout", "excite: dwell"."""
    phase, rest = split_reason(text)
    return PhaseState(phase, experiment=rest) if phase == EXCITE else PhaseState(phase, reason=rest)

"""Many sensor_msgs/JointState at once, straight from their bytes: what a loop of decoding takes minutes for."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from np_bringup.bag import Message

_STAMP = slice(4, 12)  # after the encapsulation: sec int32, nanosec uint32
_ORIGIN = 4


class BulkError(ValueError):
    """A message that is not what its topic claims; says what was expected and what came."""


def joint_states(
    bag: str, topic: str, messages: Sequence[Message], names: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """(stamps (n,) ns, values (n, 3, k): position, velocity, effort), of these names in this order.

    names None: whatever names the first message has. Raises BulkError for other names, arrays of another
    length, or numbers that are not finite.
    """
    if not messages:
        return np.zeros(0, np.int64), np.zeros((0, 3, len(names or ())))
    first = messages[0].decode()
    wanted = list(first.name) if names is None else list(names)
    start = _values_at(messages[0].data)
    head, size = messages[0].data[_STAMP.stop : start], len(messages[0].data)
    _check(f"{bag}: {topic} at {messages[0].stamp} ns", first, wanted)
    for message in messages:
        if len(message.data) != size:
            _refuse(bag, topic, message, wanted)
    table = np.frombuffer(b"".join([m.data for m in messages]), np.uint8).reshape(len(messages), size)
    # Same length and same bytes before the numbers: same names, same layout.
    strange = np.flatnonzero((table[:, _STAMP.stop : start] != np.frombuffer(head, np.uint8)).any(axis=1))
    if strange.size:
        _refuse(bag, topic, messages[strange[0]], wanted)
    seconds = np.ascontiguousarray(table[:, 4:8]).view("<i4")[:, 0].astype(np.int64)
    stamps = seconds * 1_000_000_000 + np.ascontiguousarray(table[:, 8:12]).view("<u4")[:, 0]
    count, parts, at = len(wanted), [], start
    for _ in range(3):
        at = at + 4 + (_ORIGIN - at - 4) % 8  # length, then doubles aligned to 8
        parts.append(np.ascontiguousarray(table[:, at : at + 8 * count]).view("<f8"))
        at += 8 * count
    values = np.stack(parts, axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))
    if bad.size:
        _check(f"{bag}: {topic} at {messages[bad[0]].stamp} ns", messages[bad[0]].decode(), wanted)
    return stamps, values


def _refuse(bag: str, topic: str, message: Message, names: Sequence[str]) -> None:
    place = f"{bag}: {topic} at {message.stamp} ns"
    _check(place, message.decode(), names)
    raise BulkError(f"{place}: expected the frame of the first message")


def _values_at(data: bytes) -> int:
    """Where the length of the array of positions stands."""
    at = _STAMP.stop

    def length(at: int) -> tuple[int, int]:
        at += (_ORIGIN - at) % 4
        return struct.unpack_from("<I", data, at)[0], at + 4

    size, at = length(at)  # frame_id
    count, at = length(at + size)
    for _ in range(count):
        size, at = length(at)
        at += size
    return at + (_ORIGIN - at) % 4


def _check(place: str, message, names: Sequence[str]) -> None:
    if list(message.name) != list(names):
        raise BulkError(f"{place}: JointState.name: expected the names {list(names)}, got {list(message.name)}")
    for part in ("position", "velocity", "effort"):
        values = np.asarray(getattr(message, part))
        if values.shape != (len(names),):
            raise BulkError(f"{place}: JointState.{part}: expected shape ({len(names)},), got {values.shape}")
        if not np.isfinite(values).all():
            raise BulkError(f"{place}: JointState.{part}: expected finite numbers, got {values.tolist()}")

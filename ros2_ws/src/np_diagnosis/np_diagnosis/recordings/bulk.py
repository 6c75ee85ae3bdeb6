"""Many sensor_msgs/JointState at once, straight from their bytes: what a loop of decoding takes minutes for."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from np_record.bag import Message, Rows

_STAMP = slice(4, 12)  # after the encapsulation: sec int32, nanosec uint32
_ORIGIN = 4


class BulkError(ValueError):
    """A message that is not what its topic claims; says what was expected and what came."""


def joint_states(
    bag: str, topic: str, messages: Rows | None, names: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """(stamps (n,) ns, values (n, 3, k): position, velocity, effort), of these names in this order.

    names None: whatever names the first message has. No messages are no rows. Raises BulkError for other names,
    arrays of another length, or numbers that are not finite.
    """
    if not messages:
        return np.zeros(0, np.int64), np.zeros((0, 3, len(names or ())))
    place = f"{bag}: {topic} at {messages[0].stamp} ns"
    first = decoded(place, messages[0])
    wanted = list(first.name) if names is None else list(names)
    _check(place, first, wanted)
    start, size = _values_at(messages[0].data), len(messages[0].data)
    other = np.flatnonzero(messages.end - messages.begin != size)
    if other.size:
        _refuse(bag, topic, messages[other[0]], wanted)
    table = _table(messages, size)
    fields = table.view(_layout(start, len(wanted), size))[:, 0]
    # Same length, same bytes before the numbers, and as many of these: same names, same layout.
    differs = (table[:, _STAMP.stop : start] != table[0, _STAMP.stop : start]).any(axis=1)
    for length in ("positions", "velocities", "efforts"):
        differs |= fields[length] != len(wanted)
    if differs.any():
        _refuse(bag, topic, messages[int(np.argmax(differs))], wanted)
    stamps = fields["seconds"].astype(np.int64) * 1_000_000_000 + fields["nanoseconds"]
    values = np.stack([fields[part] for part in ("position", "velocity", "effort")], axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))
    if bad.size:
        _refuse(bag, topic, messages[int(bad[0])], wanted)
    return stamps, values


def _table(messages: Rows, size: int) -> np.ndarray:
    """The bytes (n, size) of messages of one size."""
    anywhere = np.ndarray(len(messages.data) - size + 1, f"V{size}", messages.data, strides=(1,))
    return anywhere[messages.begin].view(np.uint8).reshape(len(messages), size)


def _layout(start: int, count: int, size: int) -> np.dtype:
    """Of a message of `size` bytes whose first array's length stands at `start`."""
    names, formats, offsets, at = ["seconds", "nanoseconds"], ["<i4", "<u4"], [_ORIGIN, _ORIGIN + 4], start
    for length, part in (("positions", "position"), ("velocities", "velocity"), ("efforts", "effort")):
        first = at + 4 + (_ORIGIN - at - 4) % 8  # doubles are aligned to 8
        names += [length, part]
        formats += ["<u4", ("<f8", (count,))]
        offsets += [at, first]
        at = first + 8 * count
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _refuse(bag: str, topic: str, message: Message, names: Sequence[str]) -> NoReturn:
    place = f"{bag}: {topic} at {message.stamp} ns"
    _check(place, decoded(place, message), names)
    raise BulkError(f"{place}: expected the frame of the first message")


def decoded(place: str, message: Message):
    """The message as an object. Raises BulkError where its bytes make none; place: what it is called there."""
    try:
        return message.decode()
    except Exception as error:  # any of a dozen types
        raise BulkError(f"{place}: expected a readable message, got: {error}") from error


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

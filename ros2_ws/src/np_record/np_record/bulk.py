"""Many sensor_msgs/JointState at once, from their bytes and to them: what one by one takes minutes for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NoReturn

import numpy as np

from np_record.bag import Message, TopicMessages
from np_record.cdr import STAMP, TYPESTORE, layout, serialize

JOINT_STATE = "sensor_msgs/msg/JointState"
_ARRAYS = ("position", "velocity", "effort")
_SECOND = 1_000_000_000


class BulkError(ValueError):
    """A message that is not what its topic claims; says what was expected and what came."""


def joint_states(
    bag: str, topic: str, messages: TopicMessages | None, names: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """(stamps (n,) ns, values (n, 3, k): position, velocity, effort), of these names in this order.

    names None: whatever names the first message has. No messages are no rows. Raises BulkError for other names,
    arrays of another length, or numbers that are not finite.
    """
    if not messages:
        return np.zeros(0, np.int64), np.zeros((0, 3, len(names or ())))
    place = f"{bag}: {topic} at {messages[0].stamp} ns"
    first = decode_message(place, messages[0])
    wanted = list(first.name) if names is None else list(names)
    _check(place, first, wanted)
    fields = layout(JOINT_STATE, messages[0].data)
    size = fields.itemsize
    other = np.flatnonzero(np.fromiter(map(len, messages.data), int, len(messages)) != size)
    if other.size:
        _refuse(bag, topic, messages[other[0]], wanted)
    table = np.frombuffer(b"".join(messages.data), np.uint8).reshape(len(messages), size)
    # Same length, same bytes before the numbers, and as many of these: same names, same layout.
    text = slice(STAMP.stop, fields.fields["position.length"][1])
    strange = (table[:, text] != table[0, text]).any(axis=1)
    rows = table.view(fields)[:, 0]
    for name in _ARRAYS:
        strange |= rows[f"{name}.length"] != len(wanted)
    if strange.any():
        _refuse(bag, topic, messages[int(np.argmax(strange))], wanted)
    values = np.stack([rows[name] for name in _ARRAYS], axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))
    if bad.size:
        _refuse(bag, topic, messages[int(bad[0])], wanted)
    return rows["stamp.sec"].astype(np.int64) * _SECOND + rows["stamp.nanosec"], values


def joint_state_rows(messages: Sequence[bytes], names: Sequence[str]) -> np.ndarray:
    """Values (n, 3, k), position, velocity and effort of these names, of serialized messages whose names are those of the first;
    others, and numbers that are not finite, are left out. Raises BulkError where the first lacks a name."""
    if not messages:
        return np.zeros((0, 3, len(names)))
    first = TYPESTORE.deserialize_cdr(messages[0], JOINT_STATE)
    missing = [name for name in names if name not in first.name]
    if missing:
        raise BulkError(f"joint states: expected {', '.join(missing)} among the names, got {', '.join(first.name)}")
    fields = layout(JOINT_STATE, messages[0])
    text = slice(STAMP.stop, fields.fields["position.length"][1])
    alike = [m for m in messages if len(m) == fields.itemsize and bytes(m[text]) == bytes(messages[0][text])]
    rows = np.frombuffer(b"".join(alike), fields)
    values = np.stack([rows[name] for name in _ARRAYS], axis=1)[:, :, [first.name.index(name) for name in names]]
    return values[np.isfinite(values).all(axis=(1, 2))]


def serialize_joint_states(
    stamps: np.ndarray, names: Sequence[str], position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
) -> Iterator[bytes]:
    """The bytes of JointStates at the stamps (n,) ns with an empty frame and arrays (n, len(names)) of float64."""
    kinds, zeros = TYPESTORE.types, np.zeros(len(names))
    time = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="")
    message = kinds[JOINT_STATE](header=header, name=list(names), position=zeros, velocity=zeros, effort=zeros)
    template = serialize(message)
    table = np.tile(np.frombuffer(template, np.uint8), (len(stamps), 1))
    rows = table.view(layout(JOINT_STATE, template))[:, 0]
    rows["stamp.sec"], rows["stamp.nanosec"] = stamps // _SECOND, stamps % _SECOND
    for name, values in zip(_ARRAYS, (position, velocity, effort)):
        rows[name] = values
    for row in table:
        yield row.tobytes()


def decode_message(place: str, message: Message):
    """The message as an object. Raises BulkError where its bytes make none; place: what it is called there."""
    try:
        return message.decode()
    except Exception as error:  # any of a dozen types
        raise BulkError(f"{place}: expected a readable message, got: {error}") from error


def _refuse(bag: str, topic: str, message: Message, names: Sequence[str]) -> NoReturn:
    place = f"{bag}: {topic} at {message.stamp} ns"
    _check(place, decode_message(place, message), names)
    raise BulkError(f"{place}: expected the frame of the first message")


def _check(place: str, message, names: Sequence[str]) -> None:
    if list(message.name) != list(names):
        raise BulkError(f"{place}: JointState.name: expected the names {list(names)}, got {list(message.name)}")
    for part in _ARRAYS:
        values = np.asarray(getattr(message, part))
        if values.shape != (len(names),):
            raise BulkError(f"{place}: JointState.{part}: expected shape ({len(names)},), got {values.shape}")
        if not np.isfinite(values).all():
            raise BulkError(f"{place}: JointState.{part}: expected finite numbers, got {values.tolist()}")

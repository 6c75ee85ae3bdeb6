"""Many sensor_msgs/JointState at once, from their bytes and to them: what one by one takes minutes for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from np_description.control_rate import SECOND
from np_record.bag import TopicMessages
from np_record.bag_files import BagError
from np_record.cdr import STAMP, TYPESTORE, layout, meaningful_bytes, serialize
from np_record.topics import TIMELINE

JOINT_STATE = "sensor_msgs/msg/JointState"
_ARRAYS = ("position", "velocity", "effort")
_KINDS = 20  # of messages that are read together; further ones are read one by one


def read_joint_states(bag: str, messages: TopicMessages | None, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """(times (n,) ns, values (n, 3, k): position, velocity, effort) of these joints in this order; no messages are no rows.

    Messages may name further joints, in any order. Those that name none of these, as a gripper's, are passed over; so is one that comes
    twice. Raises BagError where no message has the joints and where one has a part of them. Also for arrays of another length, and for
    numbers of these joints that are not finite.
    """
    topic = f"{bag}: {messages.topic.name}" if messages else bag
    stamps, values = _read(topic, messages, names)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, part, joint = bad[0]
        raise BagError(
            f"{topic} at {stamps[row]} ns: JointState.{_ARRAYS[part]} of {names[joint]}: expected finite numbers, "
            f"got {values[row, part, joint]}, and {len(bad)} such numbers in all"
        )
    again = np.r_[False, (np.diff(stamps) == 0) & (values[1:] == values[:-1]).all(axis=(1, 2))][: len(stamps)]
    return stamps[~again], values[~again]


def read_joint_rows(messages: Sequence[bytes], names: Sequence[str]) -> np.ndarray:
    """Values (n, 3, k) as of `read_joint_states`, of serialized messages; those with a number that is not finite are left out."""
    values = _read("joint states", TopicMessages(TIMELINE, np.arange(len(messages)), list(messages)), names)[1]
    return values[np.isfinite(values).all(axis=(1, 2))]


def has_joint(messages: TopicMessages | None, names: Sequence[str]) -> bool:
    """Whether one of these messages names one of these joints."""
    return bool(messages) and any(
        set(names) & set(named) for _, named, _ in _group_by_layout(messages.topic.name, messages)
    )


def read_joint_positions(messages: TopicMessages, name: str) -> np.ndarray:
    """Finite positions (n,) of one joint in the messages that have one, whatever else is in them."""
    topic = messages.topic.name
    found = [
        numbers[0][:, named.index(name)]
        for _, named, numbers in _group_by_layout(topic, messages)
        if name in named and numbers[0].shape[1] == len(named)
    ]
    values = np.concatenate(found) if found else np.zeros(0)
    return values[np.isfinite(values)]


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
    rows["stamp.sec"], rows["stamp.nanosec"] = stamps // SECOND, stamps % SECOND
    for name, values in zip(_ARRAYS, (position, velocity, effort)):
        rows[name] = values
    for row in table:
        yield row.tobytes()


def _read(topic: str, messages: TopicMessages | None, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    if not messages:
        return np.zeros(0, np.int64), np.zeros((0, 3, len(names)))
    values, is_read = np.empty((len(messages), 3, len(names))), np.zeros(len(messages), bool)
    seen: dict[str, None] = {}
    for rows, named, numbers in _group_by_layout(topic, messages):
        seen |= dict.fromkeys(named)
        missing = [name for name in names if named.count(name) != 1]
        if not set(names).intersection(named):
            continue
        place = f"{topic} at {messages.stamp[rows[0]]} ns"
        if missing:
            raise BagError(f"{place}: expected each joint once in a message, {', '.join(missing)} is not in {named}")
        for part, column in zip(_ARRAYS, numbers):
            if column.shape[1] != len(named):
                raise BagError(f"{place}: JointState.{part}: expected shape ({len(named)},), got ({column.shape[1]},)")
        columns = [named.index(name) for name in names]
        values[rows] = np.stack([column[:, columns] for column in numbers], axis=1)
        is_read[rows] = True
    if not is_read.any():
        raise BagError(f"{topic}: expected joints {', '.join(names)}, got {', '.join(seen) or 'none'}")
    return messages.stamp[is_read], values[is_read]


def _group_by_layout(topic: str, messages: TopicMessages) -> Iterator[tuple[np.ndarray, list[str], list[np.ndarray]]]:
    """Messages of the same layout together: (their rows (m,), the names, [position, velocity, effort] (m, length of each))."""
    sizes = np.fromiter(map(len, messages.data), int, len(messages))
    left, kinds = np.arange(len(messages)), 0
    while left.size:
        first = messages[left[0]]
        try:
            named = list(first.decode().name)
        except BagError as error:
            raise BagError(f"{topic.removesuffix(first.topic.name)}{error}") from error
        kinds += 1
        fields, is_data = layout(JOINT_STATE, first.data), meaningful_bytes(JOINT_STATE, first.data)
        rows = left[sizes[left] == fields.itemsize] if kinds < _KINDS else left[:1]
        table = np.frombuffer(b"".join(messages.data[i] for i in rows), np.uint8).reshape(len(rows), -1)
        # Same length, same bytes before the numbers, and as many of these: same names, same layout.
        text = STAMP.stop + np.flatnonzero(is_data[STAMP.stop : fields.fields["position.length"][1]])
        same = (table[:, text] == table[0, text]).all(axis=1)
        columns = table.view(fields)[:, 0]
        for part in _ARRAYS:
            same &= columns[f"{part}.length"] == columns[f"{part}.length"][0]
        yield rows[same], named, [columns[part][same].reshape(same.sum(), -1) for part in _ARRAYS]
        left = np.setdiff1d(left, rows[same], assume_unique=True)

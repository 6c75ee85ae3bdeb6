"""Serialized ROS 2 messages (CDR) without reading them one by one: the stamp, the padding, where fields lie.

No other module depends on how a message lies on the wire.

DDS leaves the bytes that align a field uninitialised, so two equal messages may differ in them. A recording
in which equal messages are equal bit for bit needs them zeroed. `padding_filter` builds, for one message
type, a function that walks a message and does that at a few microseconds a message; nothing is
deserialized. `layout` walks one message to read or write thousands like it with numpy.

Layout: 4 bytes of encapsulation, then the fields in order. Each primitive is aligned to its size, counted from
there (OMG DDS-XTYPES 1.3, 7.4.1, plain CDR version 1).
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)

STAMP = slice(4, 12)
"""The bytes of the time with which a stamped message begins: sec int32, nanosec uint32."""

_ORIGIN = 4
_FORMATS = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "float32": "<f4",
    "int64": "<i8",
    "uint64": "<u8",
    "float64": "<f8",
}
_SIZES = {name: np.dtype(code).itemsize for name, code in _FORMATS.items()}
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_ZEROS = bytes(8)

Walk = Callable[[bytearray, int], int]


def header_stamp(data: bytes) -> int:
    """Nanoseconds of the time with which a serialized message begins (any std_msgs/Header, or clock).

    Raises ValueError for data too short, or not little-endian plain CDR.
    """
    if len(data) < 12 or data[1] != 1:
        raise ValueError(f"expected little-endian CDR that begins with a time, got {bytes(data[:12]).hex()}")
    seconds, nanoseconds = _STAMP.unpack_from(data, _ORIGIN)
    return seconds * 1_000_000_000 + nanoseconds


def deserialize(data: bytes, message_type: str):
    """A serialized message as an object with the fields of its type. Raises one of many exceptions for bytes that make none.

    ROS 2 leaves some bytes after messages with empty sequences, which the library takes for a part of another message.
    """
    try:
        return TYPESTORE.deserialize_cdr(data, message_type)
    except SerdeError:
        end = _message(message_type)(bytearray(data), _ORIGIN)
        if end >= len(data):
            raise
        return TYPESTORE.deserialize_cdr(data[:end], message_type)


def to_little_endian(data: bytes, message_type: str) -> bytes:
    """A serialized message as little-endian plain CDR, the one form that this module reads, from either byte order."""
    return data if data[:2] != b"\x00\x00" else serialize(deserialize(data, message_type))


def serialize(message) -> bytes:
    """The bytes of a message made of the classes of TYPESTORE."""
    return TYPESTORE.serialize_cdr(message, message.__msgtype__)


def layout(message_type: str, data: bytes) -> np.dtype:
    """A dtype that reads and writes messages whose fields have the lengths that they have in `data`.

    For a stamped type it has the fields stamp.sec and stamp.nanosec. Each sequence of numbers in the message itself
    has two: its name, a row of numbers, and name.length, their count. The rest has no field. Expects little-endian
    bytes that can be deserialized.
    """
    names, formats, offsets = ["stamp.sec", "stamp.nanosec"], ["<i4", "<u4"], [STAMP.start, STAMP.start + 4]
    walked, position = bytearray(data), _ORIGIN
    for name, (kind, detail) in TYPESTORE.fielddefs[message_type][1]:
        begin, position = position, _field((kind, detail))(walked, position)
        if kind != Nodetype.SEQUENCE or detail[0][0] != Nodetype.BASE or detail[0][1][0] == "string":
            continue
        begin = _align(walked, begin, 4)
        number, count = np.dtype(_FORMATS[detail[0][1][0]]), _LENGTH.unpack_from(walked, begin)[0]
        names += [f"{name}.length", name]
        formats += ["<u4", (number, (count,))]
        offsets += [begin, position - count * number.itemsize]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(data)})


def meaningful_bytes(message_type: str, data: bytes) -> np.ndarray:
    """Which bytes (n,) bool of a serialized message are not padding. Expects little-endian bytes that can be deserialized."""
    walked = _Touched(data)
    walked.touched = np.zeros(len(data), bool)
    end = _message(message_type)(walked, _ORIGIN)
    walked.touched[end:] = True
    return ~walked.touched


class _Touched(bytearray):
    """Bytes that remember which padding a walk has zeroed."""

    touched: np.ndarray

    def __setitem__(self, place, value) -> None:
        if isinstance(place, slice):  # not the end of a string, which readers look at
            self.touched[place] = True


def padding_filter(message_type: str) -> Callable[[bytes], bytes]:
    """A function from a serialized message of this type to the same message with zero padding.

    The function raises ValueError for data that ends before the message does.
    """
    walk = _message(message_type)

    def filtered(data: bytes) -> bytes:
        result = bytearray(data)
        try:
            end = walk(result, _ORIGIN)
        except struct.error:
            end = len(result) + 1
        if end > len(result):
            raise ValueError(f"{message_type}: expected at least {end} bytes, got {len(result)}")
        result[end:] = bytes(len(result) - end)
        return bytes(result)

    return filtered


def _align(data: bytearray, position: int, size: int) -> int:
    gap = (_ORIGIN - position) % size
    if gap:
        data[position : position + gap] = _ZEROS[:gap]
    return position + gap


def _string(data: bytearray, position: int) -> int:
    position = _align(data, position, 4)
    end = position + 4 + _LENGTH.unpack_from(data, position)[0]
    if 0 < end <= len(data):
        data[end - 1] = 0  # the terminator: readers do not look at it
    return end


def _primitives(size: int, count: int) -> Walk:
    def walk(data: bytearray, position: int) -> int:
        return _align(data, position, size) + size * count

    return walk


def _message(message_type: str) -> Walk:
    steps = [_field(description) for _, description in TYPESTORE.fielddefs[message_type][1]]

    def walk(data: bytearray, position: int) -> int:
        for step in steps:
            position = step(data, position)
        return position

    return walk


def _field(description) -> Walk:
    kind, detail = description
    if kind == Nodetype.BASE:
        return _string if detail[0] == "string" else _primitives(_SIZES[detail[0]], 1)
    if kind == Nodetype.NAME:
        return _message(detail)
    inner, count = detail
    if kind == Nodetype.ARRAY:
        return _repeated(inner, count)
    return _sequence(inner)


def _repeated(inner, count: int) -> Walk:
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return _primitives(_SIZES[inner[1][0]], count)
    element = _field(inner)

    def walk(data: bytearray, position: int) -> int:
        for _ in range(count):
            position = element(data, position)
        return position

    return walk


def _sequence(inner) -> Walk:
    size = _SIZES.get(inner[1][0]) if inner[0] == Nodetype.BASE else None
    element = None if size else _field(inner)

    def walk(data: bytearray, position: int) -> int:
        position = _align(data, position, 4)
        count = _LENGTH.unpack_from(data, position)[0]
        position += 4
        if size:
            # An empty sequence ends after its length: no element, no alignment.
            return _align(data, position, size) + size * count if count else position
        for _ in range(count):
            position = element(data, position)
        return position

    return walk

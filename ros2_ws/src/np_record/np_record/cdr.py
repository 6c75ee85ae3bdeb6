"""Serialized ROS 2 messages (CDR) without reading them: the stamp, and the padding.

DDS leaves the bytes that align a field uninitialised, so two equal messages may differ in them. A recording
in which equal messages are equal bit for bit needs them zeroed. `padding_filter` builds, for one message
type, a function that walks a message and does that at a few microseconds a message; nothing is
deserialized.

Layout: 4 bytes of encapsulation, then the fields in order, each primitive aligned to its size counted from
there (OMG DDS-XTYPES 1.3, 7.4.1, plain CDR version 1).
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)

_ORIGIN = 4
_SIZES = {
    "bool": 1,
    "byte": 1,
    "char": 1,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "float32": 4,
    "int64": 8,
    "uint64": 8,
    "float64": 8,
}
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


def padding_filter(message_type: str, typestore: Typestore = TYPESTORE) -> Callable[[bytes], bytes]:
    """A function from a serialized message of this type to the same message with zero padding.

    The function raises ValueError for data that ends before the message does.
    """
    walk = _message(message_type, typestore)

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


def _message(message_type: str, typestore: Typestore) -> Walk:
    steps = [_field(description, typestore) for _, description in typestore.fielddefs[message_type][1]]

    def walk(data: bytearray, position: int) -> int:
        for step in steps:
            position = step(data, position)
        return position

    return walk


def _field(description, typestore: Typestore) -> Walk:
    kind, detail = description
    if kind == Nodetype.BASE:
        return _string if detail[0] == "string" else _primitives(_SIZES[detail[0]], 1)
    if kind == Nodetype.NAME:
        return _message(detail, typestore)
    inner, count = detail
    if kind == Nodetype.ARRAY:
        return _repeated(inner, count, typestore)
    return _sequence(inner, typestore)


def _repeated(inner, count: int, typestore: Typestore) -> Walk:
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return _primitives(_SIZES[inner[1][0]], count)
    element = _field(inner, typestore)

    def walk(data: bytearray, position: int) -> int:
        for _ in range(count):
            position = element(data, position)
        return position

    return walk


def _sequence(inner, typestore: Typestore) -> Walk:
    size = _SIZES.get(inner[1][0]) if inner[0] == Nodetype.BASE else None
    element = None if size else _field(inner, typestore)

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

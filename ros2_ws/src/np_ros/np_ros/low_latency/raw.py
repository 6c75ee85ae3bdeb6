"""Serialized messages that a node reads itself, of a topic from which it needs but a few."""

from __future__ import annotations

import struct

from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from np_description.control_rate import SECOND
from np_description.message_arrays import BadMessage

_HEADER = struct.Struct("<4siII")  # encapsulation, sec, nanosec, bytes of frame_id
_PLAIN = b"\0\1\0\0"  # little-endian CDR


def decode_raw(data: bytes, kind: type):
    """The message of type `kind`, or what stands at the beginning of one. Raises BadMessage (encoding).

    Where rclpy deserializes by itself it drops what cannot be read; a subscription to raw bytes has to check.
    """
    try:
        return deserialize_message(data, kind)
    except RuntimeError as error:  # rclpy's RMWError is one, and private
        raise BadMessage(
            "encoding", f"{kind.__name__}: expected a serialized one, got {len(data)} bytes: {error}"
        ) from None


def read_stamp(data: bytes) -> int:
    """Nanoseconds of the std_msgs/Header with which a serialized message begins. Raises BadMessage (encoding).

    What follows the header is left unread.
    """
    if len(data) > _HEADER.size:
        encoding, seconds, rest, length = _HEADER.unpack_from(data)
        # At a twentieth of the time of rclpy's reader, which matters at 500 Hz.
        if encoding == _PLAIN and 0 < length <= len(data) - _HEADER.size:
            return seconds * SECOND + rest
    time = decode_raw(data, Header).stamp
    return time.sec * SECOND + time.nanosec

"""Serialized messages that a node reads itself, of a topic from which it needs but a few."""

from __future__ import annotations

from rclpy.serialization import deserialize_message

from np_description.message_arrays import BadMessage


def decode_raw(data: bytes, kind: type):
    """The message of type `kind`, or what stands at the beginning of one. Raises BadMessage (encoding).

    Where rclpy deserializes by itself it drops what cannot be read; who asks for the bytes has to look.
    """
    try:
        return deserialize_message(data, kind)
    except RuntimeError as error:  # rclpy's RMWError is one, and private
        raise BadMessage(
            "encoding", f"{kind.__name__}: expected a serialized one, got {len(data)} bytes: {error}"
        ) from None

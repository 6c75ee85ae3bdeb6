"""A node to look at a graph with."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ros2_lite import ending

DISCOVERY = 1.0  # s that lists listen for other participants
_LONGEST = 0.1  # s of waiting, which a signal does not cut short


@contextmanager
def node() -> Iterator[Node]:
    """A node without parameter services, so that looking at a graph adds next to nothing to it."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield rclpy.create_node("_ros2_lite", start_parameter_services=False, enable_rosout=False)
    finally:
        rclpy.shutdown()


def spin_once(node: Node, timeout: float) -> None:
    """Serve what comes within `timeout` s, at most 0.1 s. Raises KeyboardInterrupt after a signal."""
    rclpy.spin_once(node, timeout_sec=min(timeout, _LONGEST))
    ending.heed()


def discover(node: Node) -> None:
    """Listen for other participants."""
    end = time.monotonic() + DISCOVERY
    while (left := end - time.monotonic()) > 0:
        spin_once(node, left)


def print_names(names_and_types: list[tuple[str, list[str]]], show_types: bool) -> None:
    """A line a name, with its types if asked for."""
    for name, types in sorted(names_and_types):
        print(f"{name} [{', '.join(types)}]" if show_types else name)

"""A node to look at a graph with."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

DISCOVERY = 1.0  # s that lists listen for other participants


@contextmanager
def node() -> Iterator[Node]:
    """A node without parameter services, so that looking at a graph adds next to nothing to it."""
    rclpy.init()
    try:
        yield rclpy.create_node("_ros2_lite", start_parameter_services=False, enable_rosout=False)
    except ExternalShutdownException:
        raise KeyboardInterrupt from None
    finally:
        rclpy.try_shutdown()


def spin_once(node: Node, timeout: float) -> None:
    """Serve what comes within `timeout` s. Raises KeyboardInterrupt once a signal has ended the context."""
    rclpy.spin_once(node, timeout_sec=timeout)
    if not node.context.ok():
        raise KeyboardInterrupt


def discover(node: Node) -> None:
    """Listen for other participants."""
    end = time.monotonic() + DISCOVERY
    while (left := end - time.monotonic()) > 0:
        spin_once(node, left)


def print_names(names_and_types: list[tuple[str, list[str]]], show_types: bool) -> None:
    """A line a name, with its types if asked for."""
    for name, types in sorted(names_and_types):
        print(f"{name} [{', '.join(types)}]" if show_types else name)

"""A node to look at a graph with."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ros2_lite import ending

FIRST, SETTLED = 3.0, 1.0  # s without news after which a list is complete: before the first, after the last
DISCOVERY = 15.0  # s, longest discovery of a list
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


def discover(node: Node, read: Callable[[], list], until: Callable[[list], bool] | None = None) -> list:
    """What `read` finds in the graph, once it stands still, or once `until` holds.

    It stands still where nothing is new for `SETTLED` s, or from the beginning for `FIRST` s. Where neither comes within
    `DISCOVERY` s it prints a line on stderr.
    """
    begun = time.monotonic()
    found, changed = read(), None
    while (now := time.monotonic()) < begun + DISCOVERY:
        if until(found) if until else now > (begun + FIRST if changed is None else changed + SETTLED):
            return found
        spin_once(node, _LONGEST)
        if (new := read()) != found:
            found, changed = new, time.monotonic()
    if until is None:
        print(f"the graph still changes after {DISCOVERY:g} s: this list may be incomplete", file=sys.stderr)
    return found


def print_names(names_and_types: list[tuple[str, list[str]]], show_types: bool) -> None:
    """A line a name, with its types if requested."""
    for name, types in sorted(names_and_types):
        print(f"{name} [{', '.join(types)}]" if show_types else name)

"""The idiom every node of this project follows: described parameters, diagnostics once a second, one `main`.

class Detector(Node):
    def __init__(self):
        super().__init__("keypoint_detector")
        self.rate = parameter(self, "rate", 30.0, "Images a second that are looked at.", 1.0, 60.0)
        self.diagnostics = Diagnostics(self)

def main(args=None):
    return run(Detector, args)
"""

from __future__ import annotations

import re
import signal
import sys
import time
from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NotInitializedException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from np_ros.low_latency.spin import Spinner
from np_ros.parameters import HELP, check_known, help_text
from np_ros.processes.domain import count_namesakes, ros_domain_id
from np_ros.qos import EVENT

Value = TypeVar("Value", bool, int, float, str)
_ARGUMENTS = "expected --ros-args -p NAME:=VALUE ..."


def run(
    make_node: Callable[[], Node],
    args: Sequence[str] | None = None,
    *,
    fast: bool = True,
    spin: Callable[[Node, Spinner], None] | None = None,
) -> int:
    """Construct a node and spin it until SIGINT, SIGTERM or rclpy.shutdown(); the exit status of the process.

    `--help` prints its parameters and ends. A node that cannot start ends with status 1 and one line with the reason:
    ValueError, OSError or a refused parameter in its constructor, an undeclared parameter, an argument that is none.
    Any other exception is a bug and keeps its traceback. `destroy_node` is called in every case, and is where a node
    flushes or brings to rest what it owns. `fast=False` uses rclpy's executor. `spin`: a loop of the node's own in
    place of the spinner's, calling its `spin_once`.
    """
    if set(HELP) & set(sys.argv[1:] if args is None else args):
        print(help_text(make_node))
        return 0
    node = spinner = None
    interrupts = 0

    def interrupted(number: int, frame: object) -> None:
        # rclpy's own handler came first and shut the context down, which ends the spin between two callbacks.
        # An exception here would cut one short, and lose the message that it had just taken; or cut the constructor
        # short, and leave open what it had opened. A second signal in the constructor interrupts it.
        nonlocal interrupts
        interrupts += 1
        if spinner is None and interrupts > 1:
            raise KeyboardInterrupt

    try:
        signal.signal(signal.SIGINT, interrupted)
        try:
            ros_domain_id()  # rclpy refuses a bad one with a traceback
            _init(args)
            node = make_node()
            check_known(node)
        except (ValueError, OSError, ParameterException) as error:
            rclpy.logging.get_logger(_name(make_node, args)).fatal(f"cannot start: {error}")
            return 1
        if interrupts:
            return 0
        spinner = Spinner(node, allow_fast=fast)
        spinner.spin() if spin is None else spin(node, spinner)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (RuntimeError, NotInitializedException):
        if rclpy.ok():
            raise  # else a signal came: whatever is made, taken or sent after that fails so
    finally:
        if spinner is not None:
            spinner.close()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _name(make_node: Callable[[], Node], args: Sequence[str] | None) -> str:
    """The name of a node that could not be made: as remapped on the command line, or that of its class in snake case."""
    for given in sys.argv[1:] if args is None else args:
        if given.startswith("__node:="):
            return given.removeprefix("__node:=")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", getattr(make_node, "__name__", "node")).lower().removesuffix("_node")


def _init(args: Sequence[str] | None) -> None:
    """rclpy.init; ValueError for arguments that rcl cannot read, and for what stands before `--ros-args`: rcl passes over
    it (`--x 0.5`) or renames a topic by it (`x:=0.5`), and the node would start with its defaults."""
    unread = [*takewhile(lambda given: given != "--ros-args", sys.argv[1:] if args is None else args)]
    if unread:
        raise ValueError(f"{_ARGUMENTS}, got {' '.join(unread)}")
    try:
        rclpy.init(args=args)
    except RuntimeError as error:
        raise ValueError(f"{_ARGUMENTS}, got {error}") from error


def parameter(
    node: Node,
    name: str,
    default: Value,
    description: str,
    minimum: Value | None = None,
    maximum: Value | None = None,
    *,
    choices: Sequence[str] = (),
) -> Value:
    """Declare a read-only parameter with a description and a range, and return its value.

    minimum and maximum are inclusive and of the default's type (give both or neither); `choices` lists the
    allowed strings. Raises ValueError for a value of another type, out of range, or not among the choices.
    """
    descriptor = ParameterDescriptor(description=description, read_only=True)
    if choices:
        descriptor.additional_constraints = f"one of {', '.join(choices)}"
    if minimum is not None and maximum is not None:
        if isinstance(default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=minimum, to_value=maximum)]
        else:
            descriptor.integer_range = [IntegerRange(from_value=minimum, to_value=maximum, step=1)]
    overrides = getattr(node, "_parameter_overrides", {})
    if isinstance(default, float) and name in overrides and overrides[name].type_ == Parameter.Type.INTEGER:
        overrides[name] = Parameter(name, value=float(overrides[name].value))  # yaw:=0, which rclpy would refuse
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except ParameterException as error:
        if name not in overrides:
            raise
        allowed = "" if minimum is None else f" from {minimum} to {maximum}"
        kind, given = type(default).__name__, overrides[name].value
        raise ValueError(f"parameter {name}: expected {kind}{allowed}, got {given!r}") from error
    if choices and value not in choices:
        raise ValueError(f"parameter {name}: expected one of {list(choices)}, got '{value}'")
    return value


def declare_mode(
    node: Node,
    default: str = "lockstep",
    description: str = "lockstep: time waits for the replies; realtime: nothing waits.",
) -> str:
    """Declare the parameter `mode` and return its value, lockstep or realtime. Raises ValueError for another one."""
    return parameter(node, "mode", default, description, choices=("lockstep", "realtime"))


def create_steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """A timer of `period` s that goes on when the wall clock is set: one of rclpy's own clock stands still until that has caught up."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


SUBSCRIBERS = "subscribers"
"""Key of the diagnostics value that lists the subscribers that a node has found."""
_FIRST_PAUSE, _LONGEST_PAUSE = (
    1.0,
    60.0,
)  # s between two lines on refusals for the same reason, doubled as long as they go on
_TWIN = "another node of this name is in this ROS domain: two launches? end one, or set another ROS_DOMAIN_ID"
_INFRASTRUCTURE = ("/rosout", "/parameter_events", "/diagnostics")


def _processor_wait() -> dict[str, float]:
    """`processor_wait_ms`: for how long this thread could have run and had no processor, since it began; {} where the kernel does not count it."""
    try:
        with open("/proc/thread-self/schedstat", encoding="ascii") as file:
            return {"processor_wait_ms": round(int(file.read().split()[1]) * 1e-6, 1)}
    except (OSError, IndexError):
        return {}


class Diagnostics:
    """One DiagnosticStatus of a node on `diagnostics`, once a second and whenever `publish` is called.

    `values` are shown as they are, with the thread's wait for a processor and the subscribers found; `count` adds
    up problems such as refused commands. The level is that of the last call of `report`, at least WARN for one
    period after something was counted.
    """

    def __init__(self, node: Node, period: float = 1.0):
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "diagnostics", EVENT)
        self._level, self._message = DiagnosticStatus.OK, "running"
        self._problem = ""
        self._has_twin = False
        # By reason: when a line may come again, and the pause after it.
        self._pauses: dict[str, tuple[float, float]] = {}
        self.values: dict[str, object] = {}
        self.counts: dict[str, int] = {}
        self._timer = create_steady_timer(node, period, self._tick)

    def count(self, key: str) -> None:
        """Add one to the count `key`, which raises the level to WARN until the next period."""
        self.counts[key] = self.counts.get(key, 0) + 1
        self._problem = key

    def refuse(self, reason: str, error: object) -> None:
        """Count what was not carried out under `refused_<reason>`, and log the error, ever less often while it goes on.

        rclpy's own throttle walks the stack before it suppresses a line: 0.7 ms, most of a cycle of a robot, for
        each of 500 commands a second that come too late already.
        """
        self.count(f"refused_{reason}")
        now = time.monotonic()
        again, pause = self._pauses.get(reason, (0.0, _FIRST_PAUSE))
        if now >= again:
            if now > again + pause:  # it had ended
                pause = _FIRST_PAUSE
            self._pauses[reason] = now + pause, min(2 * pause, _LONGEST_PAUSE)
            self._node.get_logger().warn(f"refused: {error}")

    def report(self, level: bytes, message: str) -> None:
        """Set the level (DiagnosticStatus.OK, WARN, ERROR) and message; publish at once if they are new."""
        if (level, message) != (self._level, self._message):
            self._level, self._message = level, message
            self.publish()

    def flush(self, timeout: float = 1.0) -> None:
        """Wait at most `timeout` s until what was published has arrived: before a node ends, or its last messages are lost."""
        self._publisher.wait_for_all_acked(Duration(seconds=timeout))

    def publish(self) -> None:
        """Publish the status now; where the context is shut down, which a signal does at any time, do nothing."""
        try:
            self._publisher.publish(self._status())
        except RuntimeError:
            if self._node.context.ok():
                raise

    def _status(self) -> DiagnosticArray:
        level, message = self._level, self._message
        if self._problem and level == DiagnosticStatus.OK:
            level, message = DiagnosticStatus.WARN, self._problem
        if self._has_twin and level == DiagnosticStatus.OK:
            level, message = DiagnosticStatus.WARN, _TWIN
        pairs = {**self.values, **self.counts, **_processor_wait(), SUBSCRIBERS: self._subscribers()}
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in pairs.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        return array

    def _subscribers(self) -> str:
        """Number of subscribers that each publisher of the node has found: "topic=count ...".

        Only the node itself can count them: what the graph shows elsewhere may not have reached it, and what it
        publishes until then is lost.
        """
        counts = {p.topic_name: p.get_subscription_count() for p in self._node.publishers}
        return " ".join(f"{topic}={count}" for topic, count in counts.items() if topic not in _INFRASTRUCTURE)

    def _tick(self) -> None:
        before, self._has_twin = self._has_twin, count_namesakes(self._node) > 0
        if self._has_twin and not before:
            self._node.get_logger().warn(f"{self._node.get_fully_qualified_name()}: {_TWIN}")
        self.publish()
        self._problem = ""

"""Low-latency spinning: one wait set that is kept, where rclpy's executor builds one for every callback.

At 500 Hz the executor of rclpy 7.1 spends 43 % of a core on that, a kept wait set 14 %, with two thirds of
the latency. Only the frequent part runs here (subscriptions, timers); services, clients, guard conditions
and quality-of-service events are left to an ordinary SingleThreadedExecutor, so that nothing rclpy can do
is lost. rclpy.experimental.EventsExecutor (7.1.6) is no replacement: between two processes it delivers no message here. The wait set is a private class of rclpy: where it is not what this file expects, `Spinner` is that
executor and nothing else.
"""

from __future__ import annotations

import ctypes
import inspect
import os
import time
from pathlib import Path

from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from np_ros.low_latency.latest_message import PolledCallbackGroup

_EVENT_PERIOD = 0.2  # s, how often events that only lead to log lines are looked for
_LOCK_ALL = 1 | 2  # MCL_CURRENT and MCL_FUTURE of mlockall(2)


class Spinner:
    """Runs the callbacks of one node in the calling thread.

    `is_fast`: whether the kept wait set is in use. Callbacks must be plain functions (no coroutines).
    """

    def __init__(self, node: Node, allow_fast: bool = True):
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._next_events = 0.0
        self.is_fast = False
        entities = (*node.subscriptions, *node.timers)
        if allow_fast and not any(inspect.iscoroutinefunction(entity.callback) for entity in entities):
            try:
                self._build()
                self.is_fast = True
            except (ImportError, AttributeError, TypeError) as error:
                node.get_logger().warn(
                    f"low-latency spinning is not available with this rclpy ({error}); using SingleThreadedExecutor"
                )

    def spin(self) -> None:
        """Run callbacks until the context is shut down.

        Raises ExternalShutdownException then, as rclpy.spin does, or whatever a callback raises.
        """
        while True:
            self.spin_once(_EVENT_PERIOD)

    def spin_once(self, timeout: float) -> None:
        """Wait up to `timeout` s and run what is ready. Raises ExternalShutdownException after a shutdown."""
        if not self.is_fast:
            self._executor.spin_once(timeout)
            if not self._node.context.ok():
                raise ExternalShutdownException()
            return
        self._wait(timeout)
        if not self._node.context.ok():
            raise ExternalShutdownException()
        self._run_ready()

    def poll(self) -> None:
        """Run the callbacks of the messages that have come, one of each subscription, and nothing else.

        A tenth of the cost of `spin_once(0)`, for a loop that something else paces; timers, services and new
        subscriptions still need a `spin_once` now and then.
        """
        if not self.is_fast:
            self.spin_once(0)
            return
        for subscription in self._entities[0]:
            self._take(subscription)

    def close(self) -> None:
        """Release the node."""
        self._executor.remove_node(self._node)
        self._executor.shutdown(timeout_sec=0)

    def _current(self) -> list[tuple]:
        node = self._node
        return [
            tuple(s for s in node.subscriptions if not isinstance(s.callback_group, PolledCallbackGroup)),
            tuple(node.timers),
            tuple(node.clients),
            tuple(node.services),
            tuple(node.guards),
        ]

    def _build(self) -> None:
        """Make the wait set anew; needed whenever the node has gained or lost an entity."""
        from rclpy.impl.implementation_singleton import rclpy_implementation as implementation

        self._entities = subscriptions, timers, clients, services, guards = self._current()
        self._subscriptions = {s.handle.pointer: s for s in subscriptions}
        self._timers = {t.handle.pointer: t for t in timers}
        # The executor's two guards wake us when the node changes and when the process is to end.
        self._guards = [self._executor._guard, self._executor._sigint_gc, *guards]
        context = self._node.context.handle
        with context:
            self._wait_set = implementation.WaitSet(
                len(subscriptions), len(self._guards), len(timers), len(clients), len(services), 0, context
            )

    def _wait(self, timeout: float) -> None:
        if self._current() != self._entities:
            self._build()
        subscriptions, timers, clients, services, _ = self._entities
        wait_set = self._wait_set
        wait_set.clear_entities()
        for subscription in subscriptions:
            wait_set.add_subscription(subscription.handle)
        for timer in timers:
            wait_set.add_timer(timer.handle)
        for client in clients:
            wait_set.add_client(client.handle)
        for service in services:
            wait_set.add_service(service.handle)
        for guard in self._guards:
            wait_set.add_guard_condition(guard.handle)
        wait_set.wait(max(0, int(timeout * 1e9)))

    def _run_ready(self) -> None:
        ready = self._wait_set.get_ready_entities
        timers, subscriptions = ready("timer"), ready("subscription")
        rare = ready("guard_condition") or ready("service") or ready("client")
        for pointer in timers:
            self._call(self._timers[pointer])
        for pointer in subscriptions:
            self._take(self._subscriptions[pointer])
        now = time.monotonic()
        if rare or now >= self._next_events:
            self._next_events = now + _EVENT_PERIOD
            if self._node.context.ok():  # else a callback has just ended it
                self._executor.spin_once(0)

    @staticmethod
    def _call(timer: Timer) -> None:
        try:
            with timer.handle:
                if not timer.handle.is_timer_ready():  # cancelled by an earlier callback
                    return
                timer.handle.call_timer()
        except InvalidHandle:  # destroyed by an earlier callback
            return
        timer.callback()

    @staticmethod
    def _take(subscription: Subscription) -> None:
        try:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except InvalidHandle:
            return
        if taken is None:
            return
        if subscription._callback_type is Subscription.CallbackType.MessageOnly:
            subscription.callback(taken[0])
        else:
            subscription.callback(*taken)


def request_realtime(priority: int = 20) -> bool:
    """Request first-in-first-out scheduling of this thread and of the middleware's from the kernel; False where it
    is not permitted. Without the middleware's, this thread would wait for messages that come at normal priority.

    On two cores with inference on both, 14 % of 2 ms deadlines were missed without it and 0.07 % with it.
    Linux grants it to users with an rtprio limit (docs/guide/quickstart.md). The process then also keeps its
    memory, if the memlock limit permits: a page that has to come back from a busy disk takes up to a second.
    """
    for thread in (0, *_middleware_threads()):
        try:
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
        except ProcessLookupError:  # a thread of the middleware has just ended
            continue
        except OSError:
            return False
    ctypes.CDLL(None).mlockall(_LOCK_ALL)
    return True


def _middleware_threads() -> list[int]:
    """Numbers of the threads that Fast DDS has started in this process, by the names that it gives them."""
    threads = []
    for task in Path("/proc/self/task").iterdir():
        try:
            name = (task / "comm").read_text()
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        if name.startswith("dds."):
            threads.append(int(task.name))
    return threads

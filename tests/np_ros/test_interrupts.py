"""Ctrl-C while messages come: a KeyboardInterrupt, whatever rclpy was at."""

import os
import signal
import threading

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import deserialize_message, serialize_message

from np_ros.client.graph_client import GraphClient
from np_ros.client.interrupts import defer_interrupts
from np_ros.client.supervised_client import SupervisedGraphClient

MESSAGE = serialize_message(DiagnosticArray(status=[DiagnosticStatus(name="x")] * 5))


def interrupted(number=signal.SIGINT):
    os.kill(os.getpid(), number)
    for _ in range(100):
        deserialize_message(MESSAGE, DiagnosticArray)


def test_an_interrupt_comes_after_the_block_and_handlers_are_those_of_before():
    before, went_on = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt):
        with defer_interrupts():
            interrupted()
            went_on.append(True)
    assert went_on and signal.getsignal(signal.SIGINT) is before


def test_an_interrupt_is_heard_where_the_block_fails():
    with pytest.raises(KeyboardInterrupt), defer_interrupts():
        interrupted()
        raise ValueError


def test_what_ends_a_process_without_a_handler_is_left_alone():
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with defer_interrupts():
            assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)


def test_in_another_thread_nothing_happens():
    seen = []

    def look():
        with defer_interrupts():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


@pytest.mark.parametrize(
    "spin",
    [lambda p: GraphClient.spin_once(p), lambda p: SupervisedGraphClient._spin_once(p)],
    ids=["peer", "participant"],
)
def test_who_asks_the_graph_is_interrupted_between_two_spins(spin):
    class Spinning:
        went_on = False

        def spin_once(self, timeout):
            interrupted()
            self.went_on = True

    class Asking:
        _spinner = Spinning()

    with pytest.raises(KeyboardInterrupt):
        spin(Asking)
    assert Asking._spinner.went_on

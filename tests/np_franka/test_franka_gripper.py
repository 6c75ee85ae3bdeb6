"""The hand's process, with a client that fails on request in place of pylibfranka; no hardware extra needed."""

import os
import signal
import time

import pytest

from np_franka.gripper import Gripper, GripperError

TIMEOUT = 30.0  # s
CLIENT = '''
import os


class FrankaException(Exception):
    pass


class Gripper:
    """Reaches what it is asked for, but: below 10 mm it says that it did not, above 70 mm it loses its
    connection. None answers at a host `nobody`."""

    def __init__(self, hostname):
        if hostname == "nobody":
            raise FrankaException("Connection refused")
        self.width, self.is_lost = 0.05, False

    def move(self, width, speed):
        self.is_lost = self.is_lost or width > 0.07
        reached = self.read_once() and width >= 0.01
        self.width = width if reached else self.width
        return bool(reached)

    def read_once(self):
        if self.is_lost:
            raise FrankaException("Connection lost")
        return self
'''


@pytest.fixture
def start(tmp_path, monkeypatch):
    """A function that starts the hand of a host."""
    (tmp_path / "pylibfranka.py").write_text(CLIENT)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    made = []

    def started(hostname="hand"):
        made.append(Gripper("fr3", hostname))
        return made[-1]

    yield started
    for gripper in made:
        gripper.close()


@pytest.fixture
def gripper(start):
    return start()


def wait(gripper, condition):
    """Listen until the condition holds."""
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, (gripper.opening, gripper.error)
        gripper.poll()


def moves(gripper, opening):
    """Whether the fingers go there, and nothing is wrong any more."""
    gripper.move(opening)
    wait(gripper, lambda: gripper.opening == pytest.approx(opening) and not gripper.error)


def test_fingers_go_where_they_are_asked_to(gripper):
    assert gripper.opening == pytest.approx(0.025)
    moves(gripper, 0.01)
    moves(gripper, 0.03)


@pytest.mark.parametrize("opening, words", [(0.001, "did not reach 0.001 m"), (0.04, "Connection lost")])
def test_a_motion_that_fails_is_told_until_the_next_succeeds(gripper, opening, words):
    gripper.move(opening)
    wait(gripper, lambda: gripper.error)
    heard = [gripper.error]
    gripper.opening = 1.0  # what is measured next comes from a hand that is connected again
    wait(gripper, lambda: heard.append(gripper.error) or gripper.opening < 1.0)
    assert all(words in error for error in heard)
    moves(gripper, 0.03)


def test_a_process_that_has_ended_is_told_and_can_be_revived(gripper):
    process = gripper._process
    gripper.revive()
    assert gripper._process is process  # nothing to do
    process.send_signal(signal.SIGKILL)
    process.wait()
    wait(gripper, lambda: "process has ended" in gripper.error)
    with pytest.raises(ValueError, match="process has ended"):
        gripper.move(0.03)
    gripper.revive()
    wait(gripper, lambda: not gripper.error)
    moves(gripper, 0.03)


def test_no_hand_at_the_start_is_an_error(start):
    with pytest.raises(GripperError, match="hand of nobody: Connection refused"):
        start("nobody")


def test_the_process_of_a_driver_at_real_time_priority_has_none(start):
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        pytest.skip("real-time priority is not permitted")
    try:
        gripper = start()
        assert os.sched_getscheduler(gripper._process.pid) == os.SCHED_OTHER
    finally:
        os.sched_setscheduler(0, *before)

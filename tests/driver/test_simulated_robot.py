"""The simulated robot is there all the time: what else the machine does is not taken for a fault."""

import os
import re
import resource
from pathlib import Path

import pytest
from simulated_robot import ROBOT_PRIORITY, SimulatedRobot

PAUSE = 0.3  # s


def kilobytes(pid, name):
    """A size in the kernel's account of a process."""
    return int(re.search(rf"{name}:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())[1])


def may(limit, wanted):
    """Whether this limit permits as much."""
    soft, _ = resource.getrlimit(limit)
    return os.geteuid() == 0 or soft == resource.RLIM_INFINITY or soft >= wanted


def test_it_keeps_its_memory_and_comes_first_where_that_is_permitted(start_robot):
    pid = start_robot()[0].process.pid
    used = kilobytes(pid, "VmRSS")
    kept = kilobytes(pid, "VmLck") >= used
    assert kept == may(resource.RLIMIT_MEMLOCK, 1024 * kilobytes(pid, "VmSize"))
    assert (os.sched_getscheduler(pid) == os.SCHED_FIFO) == may(resource.RLIMIT_RTPRIO, ROBOT_PRIORITY)


def test_it_knows_how_long_it_has_said_nothing_and_the_driver_waits_for_it(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    stamp = harness.stamp
    robot.freeze()
    harness.probe.idle_for(PAUSE)
    robot.thaw()
    harness.wait(lambda: harness.stamp > stamp + 100_000_000, "states to go on")
    assert robot.request("state")["pause"] >= 0.9 * PAUSE
    assert harness.status.get("state", "ready") == "ready"


def test_one_that_ends_says_why():
    with pytest.raises(RuntimeError, match="(?s)ended: .*could not convert string to float: 'heavy'"):
        SimulatedRobot(hand_mass="heavy")


def test_it_ends_with_its_input(start_robot):
    robot, _ = start_robot()
    robot.process.stdin.close()
    assert robot.process.wait(60.0) == 0

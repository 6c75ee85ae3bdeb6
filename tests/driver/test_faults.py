"""What breaks between driver and robot: the arm comes to rest, the driver says why, and `recover` leads
back.
"""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from backends import silent
from sensor_msgs.msg import JointState

from np_control.safety import LIMITS
from np_franka.limits import FR3_LIMITS
from np_ros.processes.supervisor import NodeDied


def moving(harness):
    """Turn joint 7 until it really turns."""
    first = harness.states[-1].position[6]
    harness.follow(harness.commands.turn, lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")


def resumes(harness):
    """Recover, as soon as the arm is at rest, and have commands taken again."""
    while not (response := harness.call("recover")).success:
        assert "still moves" in response.message, response.message
    harness.wait_state("ready")
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


def test_a_reflex_is_a_fault_in_the_robots_own_words(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    applied = harness.probe.collect("applied_command", JointState)
    moving(harness)
    harness.answer = harness.commands.turn
    robot.request("reflex")
    harness.wait_state("fault")
    assert "joint_reflex" in harness.message and harness.level == b"\x02"
    refused = harness.refused("state")
    harness.wait(lambda: harness.refused("state") > refused, "commands to be refused")
    applied.clear()
    harness.wait(lambda: len(applied) > 3, "applied_command to go on")
    assert not np.any([message.effort for message in applied])  # nothing is applied any more, and it says so
    harness.answer = silent
    harness.wait(lambda: harness.status.get("robot_errors"), "the errors in diagnostics")
    resumes(harness)
    harness.wait(lambda: harness.status.get("robot_errors") == "", "the errors to be gone")


def test_a_frozen_robot_is_a_fault_until_it_answers_again(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    moving(harness)
    stamp = harness.stamp
    robot.freeze()
    harness.wait_state("fault", "stopped")
    harness.wait(lambda: parameters["hostname"] in harness.status["last_error"], "the lost connection")
    robot.thaw()
    resumes(harness)
    assert harness.stamp > stamp  # another connection, but time has not gone back


def test_a_robot_that_is_gone_is_a_fault_and_recover_says_so(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    moving(harness)
    robot.close()
    harness.wait_state("fault")
    assert parameters["hostname"] in harness.message
    response = harness.call("recover")
    assert not response.success and parameters["hostname"] in response.message
    assert harness.status["state"] == "fault"
    assert harness.graph.kill("franka_driver", signal.SIGINT) == 0


def test_lost_cycles_are_counted_and_ridden_out(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    harness.wait(lambda: "lost_cycles" in harness.status, "the count")
    before = int(harness.status["lost_cycles"])
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken")
    harness.answer = harness.commands.stay
    harness.send(harness.commands.stay(harness.states[-1]))
    robot.request("drop 20")
    harness.wait(lambda: int(harness.status["lost_cycles"]) >= before + 20, "twenty to be counted")
    harness.wait(lambda: harness.status["state"] in ("moving", "holding"), "the arm to be held")


def test_a_new_driver_takes_over_from_a_killed_one(start_robot, start_driver):
    robot, parameters = start_robot()
    harness = start_driver(parameters)
    moving(harness)
    harness.graph.kill("franka_driver", signal.SIGKILL)
    harness.wait(lambda: robot.request("state")["mode"] == "kIdle", "the robot to notice")
    harness.wait(lambda: np.abs(robot.request("state")["dq"]).max() < LIMITS.rest_speed, "rest")
    pose = robot.request("state")["q"]
    second = start_driver(parameters)
    second.wait_state("ready")
    assert np.allclose(second.states[-1].position[:7], pose, atol=1e-2)
    second.follow(second.commands.stay, lambda: second.status.get("state") == "moving", "commands to be taken")


def test_a_robot_in_reflex_is_not_moved_before_recover(start_robot, start_driver):
    robot, parameters = start_robot()
    robot.request("reflex")
    harness = start_driver(parameters)
    harness.wait_state("fault")
    assert "Reflex" in harness.message and "joint_reflex" in harness.message
    assert robot.request("state")["mode"] == "kReflex"
    resumes(harness)


def test_a_robot_that_does_not_know_its_hand_is_not_moved(start_robot, start_driver):
    robot, parameters = start_robot(hand_mass=0.05)
    harness = start_driver(parameters)
    harness.wait_state("fault")
    assert "0.05 kg at its flange" in harness.message
    response = harness.call("recover")
    assert not response.success and "0.05 kg" in response.message
    assert robot.request("state")["mode"] == "kIdle"


def test_a_joint_driven_at_its_limit_stays_inside_its_range_and_speed(start_robot, start_driver):
    _, parameters = start_robot()
    harness = start_driver(parameters)
    wall = FR3_LIMITS.wall_upper[6]
    harness.follow(harness.commands.turn_fast, lambda: harness.states[-1].position[6] > wall - 0.02, "the soft wall")
    later = harness.stamp + 500_000_000
    harness.follow(harness.commands.turn_fast, lambda: harness.stamp > later, "half a second at the wall")
    assert harness.status["state"] == "moving"
    position = np.array([state.position[:7] for state in harness.states])
    speed = np.abs([state.velocity[:7] for state in harness.states])
    assert (position < FR3_LIMITS.position_upper).all() and (position > FR3_LIMITS.position_lower).all()
    assert (speed < LIMITS.velocity).all() and speed[:, 6].max() > 0.5 * LIMITS.velocity[6]


def hand_process(harness):
    """The process of the driver's hand."""
    pid = harness.graph.pid("franka_driver")
    return next(
        child
        for thread in Path(f"/proc/{pid}/task").iterdir()
        for child in map(int, (thread / "children").read_text().split())
        if b"np_franka.gripper" in Path(f"/proc/{child}/cmdline").read_bytes()
    )


def test_a_hand_whose_process_died_is_a_warning_until_recover_starts_another(start_robot, start_driver):
    _, parameters = start_robot()
    harness = start_driver(parameters)
    harness.wait_state("ready")
    os.kill(hand_process(harness), signal.SIGKILL)
    harness.wait(lambda: "hand: the hand's process has ended" in harness.message, "the hand's end to be told")
    assert harness.level == b"\x01" and harness.message.startswith("ready")
    harness.resume()
    harness.wait(lambda: harness.status["gripper_error"] == "" and harness.level == b"\x00", "another hand")
    process = hand_process(harness)
    assert os.sched_getscheduler(process) == os.SCHED_OTHER


@pytest.mark.parametrize(
    "parameters, text",
    [
        ({"hostname": ""}, "hostname: expected the robot's address"),
        ({"hostname": "127.255.255.1", "gripper": False}, "connection to 127.255.255.1"),
        ({"hostname": "127.255.255.1"}, "hand of 127.255.255.1"),
    ],
)
def test_without_a_robot_the_driver_ends_with_the_reason(graph, probe, parameters, text):
    graph.run("np_franka", "franka_driver", {"realtime": "ignore", **parameters})
    with pytest.raises(NodeDied, match="status 1") as died:
        probe.wait_until(lambda: False)
    assert text in str(died.value)

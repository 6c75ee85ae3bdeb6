"""The checks, in the order in which they are put: topics, states, refusals, watchdog, stop, recover, time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64

from np_control.safety import LIMITS
from np_description.message_arrays import joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_evaluation.conformance.commands import PERIOD
from np_evaluation.conformance.harness import Harness, expect, silent

PUBLISHED = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/applied_command": "sensor_msgs/msg/JointState",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
TASK_TOPICS = {
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/object_pose": "geometry_msgs/msg/PoseStamped",
    "/clock": "rosgraph_msgs/msg/Clock",
}
CAMERA_TOPICS = {"/camera/image_raw": "sensor_msgs/msg/Image", "/camera/camera_info": "sensor_msgs/msg/CameraInfo"}
SUBSCRIBED = {"/gripper_command": "std_msgs/msg/Float64"}
ANY, REAL_TIME, CAMERA, PAUSE = "any mode", "real time", "real time with a camera", "real time that can pause"


@dataclass(frozen=True)
class ConformanceCheck:
    """One requirement of the contract."""

    words: str
    """What is required."""
    asked_of: str
    """The kind of backend that it applies to."""
    run: Callable[[Harness], None]
    """Raises BackendViolation or TimeoutError where it is not met."""


CHECKS: list[ConformanceCheck] = []


def check(words: str, asked_of: str = ANY):
    """Add a check."""

    def add(run: Callable[[Harness], None]) -> Callable[[Harness], None]:
        CHECKS.append(ConformanceCheck(words, asked_of, run))
        return run

    return add


def speed(state: JointState) -> float:
    """Speed of the fastest joint, rad/s."""
    return max(map(abs, state.velocity[:7]))


def turn(harness: Harness) -> None:
    """Turn joint 7 by .02 rad."""
    first = harness.states[-1].position[6]
    harness.follow(harness.commands.turn, lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")


@check("topics and their types")
def topics(harness: Harness) -> None:
    backend, node = harness.backend, harness.peer.node
    expected = PUBLISHED | backend.commands.published
    expected |= TASK_TOPICS if backend.has_tasks else {}
    expected |= CAMERA_TOPICS if backend.has_camera else {}
    subscribed = SUBSCRIBED | backend.commands.subscribed

    def has(list_topics, wanted):
        return wanted.items() <= {topic: names[0] for topic, names in list_topics(backend.name, "/")}.items()

    harness.wait(lambda: backend.name in node.get_node_names(), "the node to be known")
    harness.wait(lambda: has(node.get_publisher_names_and_types_by_node, expected), f"it to publish {sorted(expected)}")
    harness.wait(
        lambda: has(node.get_subscriber_names_and_types_by_node, subscribed), f"it to subscribe to {sorted(subscribed)}"
    )


@check("states are whole, within limits, and stamps increase by whole periods")
def states(harness: Harness) -> None:
    harness.follow(harness.commands.stay, lambda: len(harness.states) > 100, "100 states")
    stamps = [stamp_nanoseconds(state.header.stamp) for state in harness.states]
    # A state may be published twice while time stands still; time itself never goes back.
    for earlier, later in zip(stamps, stamps[1:]):
        expect(later >= earlier, f"stamps: expected them to increase, got {later} ns after {earlier} ns")
        expect(later % PERIOD == 0, f"stamps: expected multiples of {PERIOD} ns, got {later} ns")
    for state in harness.states:
        position, _, effort = joint_state_arrays(state, STATE_NAMES)
        inside = (LIMITS.position_lower <= position[:7]).all() and (position[:7] <= LIMITS.position_upper).all()
        expect(inside, f"position: expected the joints within their range, got {position[:7].round(3).tolist()} rad")
        expect(
            (np.abs(effort[:7]) <= LIMITS.torque).all(),
            f"effort: expected torque without gravity within the limits, got {effort[:7].round(2).tolist()} Nm",
        )


@check("an accepted command moves the arm, and applied_command reports it")
def follows(harness: Harness) -> None:
    applied = harness.peer.collect("applied_command", JointState)
    harness.wait(lambda: harness.peer.publishers("applied_command"), "applied_command")
    turn(harness)
    harness.follow(
        harness.commands.turn, lambda: any(m.effort[6] > 1.0 for m in applied), "applied_command to report it"
    )
    for message in applied:
        joint_state_arrays(message, JOINT_NAMES)
        stamp = stamp_nanoseconds(message.header.stamp)
        expect(stamp % (5 * PERIOD) == 0, f"applied_command: expected stamps in 100 Hz, got {stamp} ns")


@check("bad commands are refused, counted by reason, and not applied")
def refuses(harness: Harness) -> None:
    applied = harness.peer.collect("applied_command", JointState)
    for reason, make in harness.commands.bad.items():
        harness.send_until_refused(make, reason)
        harness.resume()
    for message in applied:
        _, _, effort = joint_state_arrays(message, JOINT_NAMES)
        # Holding the posture takes next to nothing.
        expect((np.abs(effort) < 5.0).all(), f"applied torque: expected under 5 Nm, got {effort.round(1).tolist()}")
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "a good command to be taken")


@check("a late command is refused")
def late(harness: Harness) -> None:
    old = harness.commands.stay(harness.states[-1])
    until = harness.stamp + 10 * PERIOD
    harness.follow(harness.commands.stay, lambda: harness.stamp > until, "time to pass")
    before = harness.refused("late") + harness.refused("order")
    harness.send(old)
    harness.wait(
        lambda: harness.refused("late") + harness.refused("order") > before, "refused_late or refused_order to grow"
    )


def open_gripper(harness: Harness) -> None:
    harness.peer.advertise("gripper_command", Float64)
    harness.wait(lambda: harness.peer.matched("gripper_command"), "a subscriber of gripper_command")


@check("a bad gripper command is refused")
def bad_gripper(harness: Harness) -> None:
    open_gripper(harness)
    before = harness.refused("gripper")
    for count, opening in enumerate((math.nan, -0.01, 0.05), start=1):
        harness.peer.publish("gripper_command", Float64(data=opening))
        harness.wait(lambda: harness.refused("gripper") == before + count, f"refused_gripper to grow for {opening}")


@check("fingers follow the gripper command")
def fingers(harness: Harness) -> None:
    open_gripper(harness)
    for opening in (0.01, 0.02):
        harness.peer.publish("gripper_command", Float64(data=opening))
        harness.follow(
            harness.commands.stay,
            lambda: np.allclose(harness.states[-1].position[7:], opening, atol=1e-3),
            f"both fingers at {opening} m",
        )


@check("stop wins over commands until recover")
def stop(harness: Harness) -> None:
    turn(harness)
    harness.answer = harness.commands.turn
    harness.succeed("stop")
    harness.wait_state("stopped")
    harness.wait(lambda: speed(harness.states[-1]) < LIMITS.rest_speed, "rest")
    refused = harness.refused("state")
    harness.send(harness.commands.turn(harness.states[-1]))
    harness.wait(lambda: harness.refused("state") > refused, "refused_state to grow for a command after stop")
    expect(harness.status["state"] == "stopped", f"state: expected stopped, got {harness.status['state']}")
    harness.answer = silent
    if harness.backend.has_tasks:
        response = harness.call("reset")
        expect(
            not response.success and "recover" in response.message,
            f"reset of a stopped arm: expected a refusal that names recover, got {response.message!r}",
        )
    harness.succeed("recover")
    harness.wait_state("ready")
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


@check("recover without a stop is refused")
def nothing_to_recover(harness: Harness) -> None:
    response = harness.call("recover")
    expect(
        not response.success and "nothing to recover" in response.message,
        f"recover: expected 'nothing to recover', got {response.message!r}",
    )


@check("states come without commands, and the arm holds", REAL_TIME)
def command_timeout(harness: Harness) -> None:
    first = list(harness.states[-1].position[:7])
    start = harness.stamp
    harness.wait(lambda: harness.stamp >= start + 100 * PERIOD, "a hundred periods")
    state = harness.status.get("state", "ready")
    expect(state in ("idle", "ready"), f"state: expected ready, got {state}")
    off = max(abs(a - b) for a, b in zip(first, harness.states[-1].position[:7]))
    expect(off < 1e-3, f"posture: expected it held within .001 rad, got {off:.4f} rad")


@check("a silent controller leads to holding, and then to rest", REAL_TIME)
def silence(harness: Harness) -> None:
    applied = harness.peer.collect("applied_command", JointState)
    turn(harness)
    silent_since = harness.stamp
    harness.wait_state("stopped")
    # Since it was moving: a process that got no processor time receives the turn's end and the stop at once.
    since = harness.watchdog_states[::-1]
    since = since[: since.index("moving")] if "moving" in since else since
    expect("holding" in since, f"states: expected holding before stopped, got {harness.watchdog_states}")
    expect("silence" in harness.message, f"message: expected the silence to be named, got {harness.message!r}")
    least = silent_since + LIMITS.silence_ns - (LIMITS.late_periods + 1) * PERIOD
    expect(
        harness.stamp >= least,
        f"stopped: expected 200 ms of silence before it, got it {least - harness.stamp} ns early",
    )
    harness.wait(lambda: speed(harness.states[-1]) < LIMITS.rest_speed, "rest")
    harness.wait(lambda: applied and max(map(abs, applied[-1].effort)) < 1.0, "torque to fade")
    harness.succeed("recover")
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


@check("one command and then silence are reported as moving, holding, stopped", REAL_TIME)
def one_command(harness: Harness) -> None:
    harness.resume()  # its states are reported by then: what follows is of the one command
    before = len(harness.watchdog_states)
    taken = False
    while not taken:  # on a busy machine the one command may come too late, and is none then
        late = harness.refused("late")
        harness.send(harness.commands.stay(harness.states[-1]))
        harness.wait(
            lambda: harness.status.get("state") != "ready" or harness.refused("late") > late,
            "a command to be taken or refused",
        )
        taken = harness.status.get("state") != "ready"
    harness.wait_state("stopped")
    reported = list(dict.fromkeys(state for state in harness.watchdog_states[before:] if state != "ready"))
    expect(reported == ["moving", "holding", "stopped"], f"states: expected moving, holding, stopped, got {reported}")


@check("images come at their own rate", CAMERA)
def images(harness: Harness) -> None:
    received = harness.peer.collect("camera/image_raw", Image)
    harness.wait(lambda: len(received) >= 5, "images")
    stamps = [stamp_nanoseconds(image.header.stamp) for image in received]
    expect(all(b > a for a, b in zip(stamps, stamps[1:])), f"image stamps: expected them to increase, got {stamps}")
    for stamp in stamps:
        phase = stamp * 30 % 1_000_000_000  # of 1/30 s; images are taken at the nearest period of 2 ms
        expect(
            min(phase, 1_000_000_000 - phase) <= 30 * PERIOD // 2, f"image stamps: expected 30 a second, got {stamp} ns"
        )


@check("pause stops time, and step takes one period", PAUSE)
def pause(harness: Harness) -> None:
    expect(not harness.call("step").success, "step: expected a refusal while time goes on")
    for _ in range(100):  # states may still be on their way
        stepped = harness.stamp
        harness.succeed("pause", True)
        if harness.stamp == stepped:
            break
    else:
        expect(False, "pause: expected time to stand still, got newer states with each of 100 calls")
    harness.succeed("step")
    harness.wait(lambda: harness.stamp > stepped, "the state after the step")
    took = harness.stamp - stepped
    expect(took == PERIOD, f"step: expected {PERIOD} ns, got {took} ns")
    harness.succeed("pause", False)
    harness.wait(lambda: harness.stamp > stepped + 50 * PERIOD, "time to go on")

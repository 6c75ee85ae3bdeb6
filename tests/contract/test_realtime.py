"""What a backend keeps in real time: it waits for nobody, and silence brings the arm to rest."""

from backends import PERIOD
from sensor_msgs.msg import Image, JointState

from np_control.safety import LIMITS
from np_ros.messages import stamp_nanoseconds


def test_states_come_without_answers_and_the_arm_holds(realtime_start):
    harness = realtime_start()
    first = list(harness.states[-1].position[:7])
    start = harness.stamp
    harness.wait(lambda: harness.stamp >= start + 100 * PERIOD, "a hundred periods")
    assert harness.status.get("state", "ready") == "ready"
    assert all(abs(a - b) < 1e-3 for a, b in zip(first, harness.states[-1].position[:7]))


def test_a_silent_controller_leads_to_hold_and_then_to_rest(realtime_start):
    harness = realtime_start()
    applied = harness.probe.collect("applied_command", JointState)
    first = harness.states[-1].position[6]
    harness.follow(harness.commands.turn, lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")
    silent_since, before = harness.stamp, len(harness.said)
    harness.wait_state("stopped")
    assert "holding" in harness.said[before - 1 :] and "silence" in harness.message
    assert harness.stamp >= silent_since + LIMITS.silence_ns - (LIMITS.late_periods + 1) * PERIOD
    harness.wait(lambda: max(map(abs, harness.states[-1].velocity[:7])) < LIMITS.rest_speed, "rest")
    harness.wait(lambda: max(map(abs, applied[-1].effort)) < 1.0, "torque to fade")
    assert harness.call("recover").success
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


def test_one_command_and_then_silence_are_told_as_moving_holding_stopped(realtime_start):
    harness = realtime_start()
    harness.resume()  # which is told: nothing is left to be
    before = len(harness.said)
    harness.send(harness.commands.stay(harness.states[-1]))
    harness.wait_state("stopped")
    told = [state for state in harness.said[before:] if state != "ready"]
    assert list(dict.fromkeys(told)) == ["moving", "holding", "stopped"]


def test_images_come_at_their_own_rate(camera_start):
    harness = camera_start(camera=True)
    images = harness.probe.collect("camera/image_raw", Image)
    harness.wait(lambda: len(images) >= 5, "images")
    stamps = [stamp_nanoseconds(image.header.stamp) for image in images]
    assert all(later > earlier for earlier, later in zip(stamps, stamps[1:]))
    for stamp in stamps:
        phase = stamp * 30 % 1_000_000_000  # of 1/30 s; images are taken at the nearest period of 2 ms
        assert min(phase, 1_000_000_000 - phase) <= 30 * PERIOD // 2


def test_pause_stops_time_and_step_takes_one_period(pausing_start):
    harness = pausing_start()
    assert not harness.call("step").success
    assert harness.call("pause", True).success
    harness.states.clear()
    assert harness.call("step").success
    harness.wait(lambda: harness.states, "the state after the step")
    stepped = harness.stamp
    assert harness.call("step").success
    harness.wait(lambda: harness.stamp > stepped, "the state after another step")
    assert harness.stamp == stepped + PERIOD
    assert harness.call("pause", False).success
    harness.wait(lambda: harness.stamp > stepped + 50 * PERIOD, "time to go on")

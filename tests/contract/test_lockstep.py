"""What a backend that owns time keeps in lockstep: barriers, watchdog, resets, equal runs; as a process where speed or pixels matter."""

import numpy as np
from backends import PERIOD, pushing, silent, stay
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, JointState

from np_description.camera import CAMERA
from np_description.message_arrays import camera_info_arrays, image_array, stamp_nanoseconds
from np_description.panda import BASE_FRAME, NOMINAL
from np_description.phases import PhaseState
from np_record.cdr import padding_filter
from np_ros import qos
from np_ros.messages import pose_message
from np_ros.phases import phase_message

TICK = 100_000_000
FILTERS = {
    JointState: padding_filter("sensor_msgs/msg/JointState"),
    Image: padding_filter("sensor_msgs/msg/Image"),
    PoseStamped: padding_filter("geometry_msgs/msg/PoseStamped"),
    CameraInfo: padding_filter("sensor_msgs/msg/CameraInfo"),
}


def stamps(messages):
    """Stamps (ns) of messages, without repetitions."""
    return list(dict.fromkeys(stamp_nanoseconds(m.header.stamp) for m in messages))


def test_time_takes_one_period_for_each_answer(simulated_start):
    harness = simulated_start()
    harness.follow(stay, lambda: harness.stamp >= TICK, "a policy period")
    assert stamps(harness.states)[: TICK // PERIOD] == list(range(0, TICK, PERIOD))


def test_a_state_without_an_answer_is_repeated(simulated_start):
    harness = simulated_start()
    harness.follow(stay, lambda: harness.stamp >= 10 * PERIOD, "ten periods")
    harness.states.clear()
    harness.wait(lambda: len(harness.states) > len(stamps(harness.states)), "a state to come again")
    before = harness.stamp
    harness.send(stay(harness.states[-1]))
    harness.send(stay(harness.states[-1]))  # answering twice is harmless
    harness.wait(lambda: harness.stamp > before, "the next state")
    assert harness.stamp == before + PERIOD
    assert not any(key.startswith("refused") for key in harness.status)
    broken = stay(harness.states[-2])
    broken.effort[3] = float("nan")
    harness.send(broken)
    harness.wait(lambda: harness.refused("not_finite") == 1, "a broken second answer to be counted")


def test_policy_ticks_wait_for_tick_and_in_post_for_the_target(simulated_start):
    harness = simulated_start(tick_barrier=True)
    for topic, message_type in (("episode/tick", DiagnosticArray), ("target_pose", PoseStamped)):
        harness.probe.advertise(topic, message_type)
        harness.wait(lambda: harness.probe.matched(topic), topic)
    harness.answer = stay
    harness.send(stay(harness.states[-1]))
    harness.wait(lambda: harness.status.get("waiting_for") == "episode/tick", "the bridge to wait for the tick")
    harness.probe.publish("episode/tick", DiagnosticArray())
    harness.wait(lambda: harness.refused("names") == 1, "a tick that says no phase to be refused")
    assert harness.stamp == 0
    harness.probe.publish("episode/tick", phase_message(PhaseState("approach"), 0))
    harness.wait(lambda: harness.stamp == TICK, "the next policy tick")
    harness.wait(lambda: harness.status.get("waiting_for") == "episode/tick", "the bridge to wait for the tick")
    harness.probe.publish("episode/tick", phase_message(PhaseState("post"), TICK))
    harness.wait(lambda: harness.status.get("waiting_for") == "target_pose", "it to wait for the target")
    assert harness.stamp == TICK
    harness.probe.publish("target_pose", pose_message(TICK, BASE_FRAME, [0.5, 0, 0.2], [0, 1, 0, 0]))
    harness.wait(lambda: harness.stamp == 2 * TICK, "the policy tick after it")
    harness.answer = silent


def test_an_answer_that_never_comes_stops_the_arm_and_is_named(simulated_start):
    harness = simulated_start(tick_barrier=True, lockstep_timeout=1.0)
    harness.probe.publish("episode/phase", phase_message(PhaseState("pre")), qos.LATCHED)
    harness.wait_state("stopped")
    assert "no episode/tick" in harness.message and "0 ns" in harness.message


def test_silence_holds_after_three_periods_and_stops_after_200_ms(simulated_start):
    harness = simulated_start()
    first = harness.states[-1].position[6]
    harness.follow(pushing(1.5), lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")
    last = harness.stamp  # the newest state is not answered

    def step():
        before = harness.stamp
        assert harness.call("step").success
        harness.wait(lambda: harness.stamp == before + PERIOD, "the next state")

    answered = last - PERIOD
    while harness.stamp - answered <= 3 * PERIOD:
        step()
    harness.wait_state("moving")
    step()
    harness.wait_state("holding")
    while harness.stamp - answered < 200_000_000:
        step()
    assert harness.status["state"] == "holding"
    step()
    harness.wait_state("stopped")
    assert "silence" in harness.message
    harness.wait(lambda: max(map(abs, harness.states[-1].velocity[:7])) < 0.05, "rest")
    refused = harness.refused("state")
    harness.send(stay(harness.states[-1]))
    harness.wait(lambda: harness.refused("state") > refused, "commands to be refused until recover")
    assert harness.call("recover").success
    harness.follow(stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


def test_refused_answers_lead_to_rest_and_not_to_a_hang(simulated_start):
    harness = simulated_start()
    harness.follow(pushing(1.5), lambda: harness.stamp >= 20 * PERIOD, "twenty periods")
    harness.follow(
        lambda state: stay(state, effort=[float("nan")] * 7),
        lambda: harness.status.get("state") == "stopped",
        "the watchdog to stop the arm",
    )
    assert harness.refused("not_finite") >= 100
    harness.wait(lambda: max(map(abs, harness.states[-1].velocity[:7])) < 0.05, "rest")


def test_pause_and_step(simulated_start):
    harness = simulated_start()
    assert harness.call("pause", True).success
    harness.send(stay(harness.states[-1]))
    assert harness.call("step").success
    harness.wait(lambda: harness.stamp == PERIOD, "one period")
    harness.send(stay(harness.states[-1]))  # waits for the end of the pause
    assert harness.call("pause", False).success
    harness.wait(lambda: harness.stamp == 2 * PERIOD, "the period after the pause")


def record(harness, end, answer):
    """What a backend says from the second tick to `end` (ns): topic -> stamp -> bytes with zero padding."""
    probe = harness.probe
    types = {
        "joint_states": JointState,
        "applied_command": JointState,
        "object_pose": PoseStamped,
        "camera/image_raw": Image,
        "camera/camera_info": CameraInfo,
    }
    for topic, message_type in types.items():
        if topic != "joint_states":
            probe.collect(topic, message_type)
    harness.wait(lambda: all(probe.publishers(topic) for topic in types), "its publishers")
    # Until all is matched the first state is repeated, so that nothing of it is missed.
    seen = [probe.messages[topic] for topic in ("object_pose", "camera/image_raw", "camera/camera_info")]
    harness.wait(lambda: all(seen), "the first image")
    harness.follow(answer, lambda: harness.stamp >= end, f"{end} ns")
    harness.wait(lambda: all(stamps(messages)[-1] >= end for messages in seen), "the last image")
    applied = probe.messages["applied_command"]
    harness.wait(lambda: stamps(applied)[-1] >= end - 5 * PERIOD, "the last applied command")
    return {
        topic: {
            stamp_nanoseconds(m.header.stamp): FILTERS[message_type](serialize_message(m))
            for m in probe.messages[topic]
            if stamp_nanoseconds(m.header.stamp) >= TICK
        }
        for topic, message_type in types.items()
    }


def swing(state):
    """A controller whose torque is a function of the state alone."""
    error = NOMINAL.ready - np.array(state.position[:7])
    wave = 3 * np.sin(stamp_nanoseconds(state.header.stamp) * 1e-8 + np.arange(7))
    return stay(state, effort=list(20 * error - 2 * np.array(state.velocity[:7]) + wave))


def test_equal_runs_are_equal_bit_for_bit_at_any_speed(lockstep_start):
    end = 4 * TICK

    def record_run(seed, answer):
        harness = lockstep_start(camera=True, seed=seed)
        recorded = record(harness, end, lambda state: answer(harness, state))
        harness.graph.close()
        return recorded

    def twice(harness, state):
        harness.send(swing(state))
        return swing(state)

    first = record_run(3, lambda harness, state: swing(state))
    assert sorted(first["joint_states"]) == list(range(TICK, end + 1, PERIOD))
    assert sorted(first["camera/image_raw"])[:4] == [TICK, 134_000_000, 166_000_000, 2 * TICK]
    assert sorted(first["object_pose"]) == sorted(first["camera/image_raw"])
    assert sorted(first["applied_command"]) == list(range(TICK, end, 5 * PERIOD))
    assert record_run(3, twice) == first  # another speed, every answer given twice
    other = record_run(4, lambda harness, state: swing(state))
    for topic in ("object_pose", "camera/image_raw"):
        assert other[topic] != first[topic]


def test_camera_info_and_images_agree(lockstep_start):
    harness = lockstep_start(camera=True)
    images = harness.probe.collect("camera/image_raw", Image)
    infos = harness.probe.collect("camera/camera_info", CameraInfo)
    harness.wait(lambda: images and infos, "an image and its camera_info")
    width, height, matrix = camera_info_arrays(infos[0])
    assert image_array(images[0]).shape == (height, width, 3) == (CAMERA.height, CAMERA.width, 3)
    assert (matrix == CAMERA.matrix).all()
    assert images[0].header == infos[0].header


def test_resets_draw_the_task_from_seed_and_number_alone(simulated_start):
    def tasks(seed, disturb):
        harness = simulated_start(seed=seed)
        goals = harness.probe.collect("goal_pose", PoseStamped, qos.LATCHED)
        objects = harness.probe.collect("object_pose", PoseStamped)
        drawn = []
        for _ in range(3):
            if disturb:
                goal = harness.stamp + 7 * PERIOD
                harness.follow(pushing(1.5), lambda: harness.stamp >= goal, "seven periods")
            before = harness.stamp
            response = harness.call("reset")
            assert response.success, response.message
            at = (before // TICK + 1) * TICK
            harness.wait(
                lambda: harness.stamp == at
                and goals
                and stamps(goals)[-1] == at
                and objects
                and stamps(objects)[-1] == at,
                "the state of the episode",
            )
            state = harness.states[-1]
            drawn.append(
                [response.message.split(" at ")[0], goals[-1].pose, objects[-1].pose, state.position, state.velocity]
            )
            assert np.allclose(state.position[:7], NOMINAL.ready) and not any(state.velocity)
        return drawn

    first = tasks(5, disturb=False)
    assert [name for name, *_ in first] == ["episode 0", "episode 1", "episode 2"]
    assert first[0][1] != first[1][1] and first[0][2] != first[1][2]
    assert tasks(5, disturb=True) == first
    assert all(a[1] != b[1] for a, b in zip(tasks(6, disturb=False), first))


def test_the_goal_is_latched(simulated_start):
    harness = simulated_start()
    harness.follow(stay, lambda: harness.stamp >= TICK, "a policy period")
    goals = harness.probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    harness.wait(lambda: goals, "the goal, long after it was published")
    assert goals[0].header.frame_id == BASE_FRAME

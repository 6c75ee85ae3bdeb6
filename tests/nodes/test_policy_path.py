"""pre_contact, approach, post_contact and episode; the test is backend and perception."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from graph_tools import refusal
from policy_path import GOAL, HAND, NODES, TICK
from sensor_msgs.msg import JointState

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, pose_distance
from np_description.domains import CARD
from np_description.message_arrays import (
    gains_array,
    keypoints_array,
    pose_arrays,
    stamp_nanoseconds,
    trajectory_arrays,
)
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL
from np_description.phases import PhaseState
from np_perception.pose_estimation import project_keypoints
from np_policy.action import RESIDUAL_LIMITS_FINAL
from np_policy.nodes import episode_node, post_contact_node
from np_ros import qos
from np_ros.phases import refusal_reason


def run_to_post(backend, first):
    """From a reset at tick `first` until the first tick of phase post; its stamp."""
    stamp = backend.tick(first)
    backend.goal(stamp)
    backend.stand(stamp)
    backend.see(stamp)
    backend.start()
    backend.wait(
        lambda: (stamp, "approach") in backend.ticks() and backend.received("joint_trajectory"),
        "the first tick of the approach",
    )
    joints = trajectory_arrays(backend.received("joint_trajectory")[-1], JOINT_NAMES)[1][-1]
    while backend.ticks()[-1][1] == "approach":
        stamp += TICK
        backend.stand(stamp, joints)
        backend.see(stamp)
        backend.wait(lambda: backend.ticks()[-1][0] == stamp, f"the tick of {stamp} ns")
    assert backend.ticks()[-1] == (stamp, "post")
    return stamp, joints


def test_an_episode_from_keypoints_to_success(begin):
    backend = begin(success_frames=3)
    stamp, joints = run_to_post(backend, 1)
    goal = keypoints_array(backend.received("goal_keypoints")[-1])
    np.testing.assert_allclose(goal, project_keypoints(CARD, GOAL), atol=1e-4)
    assert backend.received("gripper_command")[0].data == pytest.approx(0.01)
    wanted = backend.received("pre_contact_pose")[0]
    assert stamp_nanoseconds(wanted.header.stamp) == backend.tick(1)
    position, quaternion = pose_arrays(wanted, BASE_FRAME)
    np.testing.assert_allclose(position, HAND, atol=1e-6)
    plan = backend.received("joint_trajectory")[0]
    times, positions, velocities = trajectory_arrays(plan, JOINT_NAMES)
    assert stamp_nanoseconds(plan.header.stamp) == backend.tick(1) and plan.header.frame_id == BASE_FRAME
    np.testing.assert_array_equal(positions[0], NOMINAL.ready)
    distance, angle = pose_distance(joints, position, matrix_from_quaternion(quaternion))
    assert distance < 1e-3 and angle < 5e-3 and not velocities[-1].any()
    passed = stamp - backend.tick(1)
    assert passed >= (times[-1] + 0.3) * 1e9 > passed - TICK
    # The first target answers the tick at which post begins.
    backend.wait(lambda: backend.received("target_pose"), "the first target")
    target = backend.received("target_pose")[0]
    assert stamp_nanoseconds(target.header.stamp) == stamp
    hand, _ = forward_kinematics(joints)
    assert np.abs(pose_arrays(target, BASE_FRAME)[0] - hand).max() <= RESIDUAL_LIMITS_FINAL.position + 1e-9
    backend.wait(lambda: backend.received("target_gains"))
    assert (gains_array(backend.received("target_gains")[0])[1] >= 0.5).all()
    for i in range(1, 4):
        backend.stand(stamp + i * TICK, joints)
        backend.see(stamp + i * TICK, GOAL)
    backend.wait(lambda: backend.phase() == "succeeded", "success")
    exact = {"position_bound": "0.0000", "angle_bound": "0.0000"}  # as these keypoints are
    on_the_way = [PhaseState(name) for name in ("idle", "pre", "approach", "post")]
    assert backend.phases() == [*on_the_way, PhaseState("succeeded", **exact)]
    backend.wait(lambda: backend.ticks()[-1][0] >= stamp + 2 * TICK, "the last tick")
    assert backend.ticks()[-1] == (stamp + 2 * TICK, "post")  # the tick of success is not published


def test_equal_inputs_give_equal_plans_and_actions(begin):
    backend = begin(success_frames=100)

    def targets():
        """By stamp, with the gains that came before: on a busy machine one is asked for, and given, again."""
        pairs = zip(backend.received("target_pose"), backend.received("target_gains"))
        return {
            stamp_nanoseconds(pose.header.stamp): (*pose_arrays(pose, BASE_FRAME), gains_array(g)) for pose, g in pairs
        }

    def run(first):
        for topic in ("joint_trajectory", "target_pose", "target_gains"):
            backend.received(topic).clear()
        stamp, joints = run_to_post(backend, first)
        for i in range(6):
            backend.stand(stamp + i * TICK, joints)
            backend.see(stamp + i * TICK)
            backend.wait(lambda: stamp + i * TICK in targets(), f"target {i}")
        assert backend.probe.call("episode/stop").success
        plan = b"".join(
            array.tobytes() for array in trajectory_arrays(backend.received("joint_trajectory")[0], JOINT_NAMES)
        )
        return plan, [b"".join(part.tobytes() for part in targets()[stamp + i * TICK]) for i in range(6)]

    first, second = run(1), run(200)
    assert first == second
    assert len(set(first[1])) > 1  # the last action matters


def test_unusable_keypoints_end_in_failed_pre(begin):
    backend = begin(pre_timeout=0.3)
    backend.goal(backend.tick(1))
    backend.start()
    for i in range(1, 4):
        backend.see(backend.tick(i), score=0.0)
        backend.wait(lambda: (backend.tick(i), "pre") in backend.ticks())
    backend.see(backend.tick(4), score=0.0)
    backend.wait(lambda: backend.phase().startswith("failed: pre: fewer than 6 usable keypoints"))
    assert backend.ticks()[-1] == (backend.tick(3), "pre")
    assert not backend.received("pre_contact_pose")


def test_no_keypoints_at_all_end_in_failed_pre(begin):
    backend = begin(silence=0.5)
    backend.goal(backend.tick(1))
    backend.start()
    backend.wait(lambda: backend.phase() == "failed: pre: no keypoints within 0.5 s")


def test_keypoints_that_are_not_numbers_are_refused_and_counted(begin):
    backend = begin()
    backend.goal(backend.tick(1))
    backend.start()
    backend.see(backend.tick(1), value=np.nan)
    backend.wait(lambda: (backend.tick(1), "pre") in backend.ticks(), "time to go on without them")
    refused = set()

    def counted():
        for array in backend.received("diagnostics"):
            refused.update(
                status.name
                for status in array.status
                for value in status.values
                if value.key == "refused_finite" and int(value.value) > 0
            )
        return refused == {f"/{name}" for name in NODES}

    backend.wait(counted, "the count of all four nodes")
    assert not backend.received("pre_contact_pose")
    backend.stand(backend.tick(2))
    backend.see(backend.tick(2))
    backend.wait(lambda: (backend.tick(2), "approach") in backend.ticks(), "the approach from the next image")


def test_what_got_lost_is_answered_again(begin):
    backend = begin()
    stamp, joints = run_to_post(backend, 1)
    backend.wait(lambda: backend.received("target_pose"), "the first target")
    for topic in ("episode/tick", "target_pose", "target_gains"):
        backend.received(topic).clear()
    backend.see(stamp)  # the backend asks again
    backend.wait(
        lambda: backend.received("target_pose")
        and backend.received("target_gains")
        and backend.received("episode/tick")
    )
    assert (
        {s for s, _ in backend.ticks()}
        == {stamp}
        == {stamp_nanoseconds(m.header.stamp) for m in backend.received("target_pose")}
    )


def test_a_plan_that_got_lost_is_given_again(begin):
    """For example to a controller that joined too late to receive it."""
    backend = begin()
    stamp = backend.tick(1)
    backend.goal(stamp)
    backend.stand(stamp)
    backend.see(stamp)
    backend.start()
    backend.wait(lambda: backend.received("joint_trajectory"), "the plan")
    plan = backend.received("joint_trajectory")[0]
    backend.received("joint_trajectory").clear()
    backend.wait(lambda: backend.received("joint_trajectory"), "the plan again")  # the backend repeats what it said
    assert backend.received("joint_trajectory")[0] == plan


def test_a_backend_that_was_restarted_may_give_a_goal_of_the_same_stamp(begin):
    """Each begins at 0 s and its first episode a tick later; the goal of 0 s is lost on who was busy meanwhile, for one is latched."""
    backend = begin()
    run_to_post(backend, 1)
    for topic in ("goal_keypoints", "episode/tick"):
        backend.received(topic).clear()
    backend.restart()
    backend.goal(backend.tick(1))
    backend.wait(lambda: backend.phase() == "failed: post: the task was reset")
    backend.stand(backend.tick(1))
    backend.see(backend.tick(1))
    backend.start()
    backend.wait(lambda: (backend.tick(1), "approach") in backend.ticks(), "the approach")


def test_a_listener_that_asks_for_what_is_not_offered_holds_nobody_up(begin):
    """It never hears anything, and is none."""
    backend = begin()
    backend.probe.node.create_subscription(PoseStamped, "pre_contact_pose", lambda _: None, qos.LATCHED)
    backend.probe.wait_until_ready(set(NODES))
    stamp = backend.tick(1)
    backend.goal(stamp)
    backend.stand(stamp)
    backend.see(stamp)
    backend.start()
    backend.wait(lambda: (stamp, "approach") in backend.ticks(), "the approach")


def test_an_unreachable_pose_ends_in_failed_approach_with_the_reason(begin):
    backend = begin(position=(1.3, 0.0, 0.3))
    backend.goal(backend.tick(1))
    backend.stand(backend.tick(1))
    backend.see(backend.tick(1))
    backend.start()
    backend.wait(lambda: backend.phase().startswith("failed: approach: unreachable: no posture"))
    backend.wait(lambda: backend.received("approach/refusal"))
    refusal = backend.received("approach/refusal")[-1]
    assert stamp_nanoseconds(refusal.header.stamp) == backend.tick(1)
    assert backend.phases()[-1] == PhaseState("failed", f"approach: {refusal_reason(refusal)}")
    assert not backend.ticks() and not backend.received("joint_trajectory")


def test_a_hold_of_the_backend_is_a_fault(begin):
    backend = begin()
    backend.goal(backend.tick(1))
    backend.start()
    backend.wait(lambda: backend.phase() == "pre")

    def report(level, text):
        status = DiagnosticStatus(name="/sim_bridge", level=level, message=text)
        backend.probe.publish("diagnostics", DiagnosticArray(status=[status]), qos.EVENT)

    report(DiagnosticStatus.ERROR, "stopped: torque")
    backend.wait(lambda: backend.phase() == "fault: stopped: torque")
    refusal = backend.probe.call("episode/start")
    assert not refusal.success and "stopped: torque" in refusal.message
    report(DiagnosticStatus.OK, "running")
    backend.wait(lambda: backend.probe.call("episode/start").success)


def test_a_node_without_weights_does_not_start_and_names_the_file(capfd, tmp_path):
    said = refusal(capfd, post_contact_node.main, weights=tmp_path)
    assert "post_contact_card.safetensors" in said and "make train" in said


def test_a_mode_that_does_not_exist_is_refused(capfd):
    assert "lockstep" in refusal(capfd, episode_node.main, mode="slow")


def test_bytes_that_are_no_joint_state_are_refused_and_nobody_dies(begin):
    """The policies read joint states themselves, ten of 500 a second; what `fuzz` sent ended them."""
    backend = begin()
    backend.probe.advertise("joint_states", JointState).publish(b"\x00\x01\x00\x00\x01")
    refused = {}

    def both():
        for status in (status for array in backend.received("diagnostics") for status in array.status):
            refused[status.name] = {pair.key: pair.value for pair in status.values}.get("refused_encoding")
        return refused.get("/approach") == refused.get("/post_contact") == "1"

    backend.wait(both, "both to have refused it")

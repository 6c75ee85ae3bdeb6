"""pre_contact, approach, post_contact and episode; the test is backend and perception."""

from functools import cache

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from graph_tools import refusal
from policy_weights import write_policies
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, pose_distance
from np_description.domains import CARD, sample_task
from np_description.message_arrays import (
    gains_array,
    keypoints_array,
    pose_arrays,
    stamp_nanoseconds,
    trajectory_arrays,
)
from np_description.panda import BASE_FRAME, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.phases import PhaseState
from np_perception.pose_estimation import project_keypoints
from np_policy.action import RESIDUAL_LIMITS_FINAL
from np_policy.nodes import episode_node, post_contact_node
from np_ros import qos
from np_ros.messages import joint_state_message, keypoints_message, pose_message
from np_ros.phases import phase_state, refusal_reason

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))
HAND = (START.position[0], START.position[1], 0.05)
NODES = ("pre_contact", "approach", "post_contact", "episode")
INPUTS = {
    "goal_pose": (PoseStamped, qos.LATCHED),
    "keypoints": (PointCloud2, qos.LOCKSTEP),
    "joint_states": (JointState, qos.LOCKSTEP),
    "diagnostics": (DiagnosticArray, qos.EVENT),
}
OUTPUTS = {
    "episode/phase": (DiagnosticArray, qos.RECORDER_LATCHED),  # each of several in a row
    "episode/tick": (DiagnosticArray, qos.LOCKSTEP),
    "goal_keypoints": (PointCloud2, qos.LATCHED),
    "gripper_command": (Float64, qos.EVENT),
    "pre_contact_pose": (PoseStamped, qos.EVENT),
    "joint_trajectory": (JointTrajectory, qos.EVENT),
    "approach/refusal": (DiagnosticArray, qos.EVENT),
    "target_gains": (Float64MultiArray, qos.LOCKSTEP),
    "target_pose": (PoseStamped, qos.LOCKSTEP),
}


class Backend:
    """What the nodes under test hear, and what they have said."""

    def __init__(self, probe, graph):
        self.probe, self.graph = probe, graph
        self._last = {}
        self._repeat_at = 0.0

    def tick(self, number):
        """Stamp (ns) of a policy tick, counted from 1."""
        return number * TICK

    def goal(self, stamp):
        self.probe.publish("goal_pose", pose_message(stamp, BASE_FRAME, GOAL.position, GOAL.quaternion), qos.LATCHED)
        self.wait(lambda: [m for m in self.said("goal_keypoints") if stamp_nanoseconds(m.header.stamp) == stamp])

    def see(self, stamp, pose=START, score=1.0, value=None):
        points = project_keypoints(CARD, pose)
        points[:, 2] = score
        if value is not None:
            points[0, 0] = value
        self._publish("keypoints", keypoints_message(stamp, "camera", points))

    def stand(self, stamp, joints=NOMINAL.ready):
        self._publish(
            "joint_states", joint_state_message(stamp, STATE_NAMES, [*joints, 0.01, 0.01], np.zeros(9), np.zeros(9))
        )

    def _publish(self, topic, message):
        self._last[topic] = message
        self._repeat_at = self.graph.seconds + 1.0
        self.probe.publish(topic, message)

    def forget(self):
        """It is another one from now on, which does not publish again what the one before had."""
        self._last.clear()

    def said(self, topic):
        return self.probe.messages[topic]

    def phases(self):
        return [phase_state(message) for message in self.said("episode/phase")]

    def phase(self):
        return str(self.phases()[-1]) if self.said("episode/phase") else ""

    def ticks(self):
        return [(stamp_nanoseconds(m.header.stamp), phase_state(m).phase) for m in self.said("episode/tick")]

    def wait(self, condition, what="the condition"):
        """Until the condition holds; what got lost is published again after a second, as backends do in lockstep."""

        def met():
            if self.graph.seconds > self._repeat_at:
                self._repeat_at = self.graph.seconds + 1.0
                for topic, message in self._last.items():
                    self.probe.publish(topic, message)
            return condition()

        self.probe.wait_until(met, what=what)

    def start(self):
        response = self.probe.call("episode/start")
        assert response.success, response.message


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """The folder of policies of which the student wants the hand at a position."""
    return cache(lambda position: str(write_policies(tmp_path_factory.mktemp("weights"), CARD, position=position)))


@pytest.fixture
def begin(graph, probe, weights):
    """Starts the four nodes, the student's hand at a position; options: parameters of `episode`."""

    def begun(position=HAND, mode="lockstep", **episode):
        for topic, (kind, profile) in OUTPUTS.items():
            probe.collect(topic, kind, profile)
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
        for topic, (kind, profile) in INPUTS.items():
            probe.advertise(topic, kind, profile)
        own = {
            "pre_contact": {"weights": weights(position)},
            "approach": {"improve_checks": 2000},
            "post_contact": {"weights": weights(HAND)},
            "episode": episode,
        }
        for name, given in own.items():
            graph.run("np_policy", name, {"mode": mode, "domain": "card", **given})
        probe.wait_until_ready(set(NODES))
        return Backend(probe, graph)

    return begun


def run_to_post(backend, first):
    """From a reset at tick `first` until the first tick of phase post; its stamp."""
    stamp = backend.tick(first)
    backend.goal(stamp)
    backend.stand(stamp)
    backend.see(stamp)
    backend.start()
    backend.wait(
        lambda: (stamp, "approach") in backend.ticks() and backend.said("joint_trajectory"),
        "the first tick of the approach",
    )
    joints = trajectory_arrays(backend.said("joint_trajectory")[-1], JOINT_NAMES)[1][-1]
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
    goal = keypoints_array(backend.said("goal_keypoints")[-1])
    np.testing.assert_allclose(goal, project_keypoints(CARD, GOAL), atol=1e-4)
    assert backend.said("gripper_command")[0].data == pytest.approx(0.01)
    wanted = backend.said("pre_contact_pose")[0]
    assert stamp_nanoseconds(wanted.header.stamp) == backend.tick(1)
    position, quaternion = pose_arrays(wanted, BASE_FRAME)
    np.testing.assert_allclose(position, HAND, atol=1e-6)
    plan = backend.said("joint_trajectory")[0]
    times, positions, velocities = trajectory_arrays(plan, JOINT_NAMES)
    assert stamp_nanoseconds(plan.header.stamp) == backend.tick(1) and plan.header.frame_id == BASE_FRAME
    np.testing.assert_array_equal(positions[0], NOMINAL.ready)
    distance, angle = pose_distance(joints, position, matrix_from_quaternion(quaternion))
    assert distance < 1e-3 and angle < 5e-3 and not velocities[-1].any()
    passed = stamp - backend.tick(1)
    assert passed >= (times[-1] + 0.3) * 1e9 > passed - TICK
    # The first target answers the tick at which post begins.
    backend.wait(lambda: backend.said("target_pose"), "the first target")
    target = backend.said("target_pose")[0]
    assert stamp_nanoseconds(target.header.stamp) == stamp
    hand, _ = forward_kinematics(joints)
    assert np.abs(pose_arrays(target, BASE_FRAME)[0] - hand).max() <= RESIDUAL_LIMITS_FINAL.position + 1e-9
    backend.wait(lambda: backend.said("target_gains"))
    assert (gains_array(backend.said("target_gains")[0])[1] >= 0.5).all()
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
        pairs = zip(backend.said("target_pose"), backend.said("target_gains"))
        return {
            stamp_nanoseconds(pose.header.stamp): (*pose_arrays(pose, BASE_FRAME), gains_array(g)) for pose, g in pairs
        }

    def run(first):
        for topic in ("joint_trajectory", "target_pose", "target_gains"):
            backend.said(topic).clear()
        stamp, joints = run_to_post(backend, first)
        for i in range(6):
            backend.stand(stamp + i * TICK, joints)
            backend.see(stamp + i * TICK)
            backend.wait(lambda: stamp + i * TICK in targets(), f"target {i}")
        assert backend.probe.call("episode/stop").success
        plan = b"".join(
            array.tobytes() for array in trajectory_arrays(backend.said("joint_trajectory")[0], JOINT_NAMES)
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
    assert not backend.said("pre_contact_pose")


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
        for array in backend.said("diagnostics"):
            refused.update(
                status.name
                for status in array.status
                for value in status.values
                if value.key == "refused_finite" and int(value.value) > 0
            )
        return refused == {f"/{name}" for name in NODES}

    backend.wait(counted, "the count of all four nodes")
    assert not backend.said("pre_contact_pose")
    backend.stand(backend.tick(2))
    backend.see(backend.tick(2))
    backend.wait(lambda: (backend.tick(2), "approach") in backend.ticks(), "the approach from the next image")


def test_what_got_lost_is_answered_again(begin):
    backend = begin()
    stamp, joints = run_to_post(backend, 1)
    backend.wait(lambda: backend.said("target_pose"), "the first target")
    for topic in ("episode/tick", "target_pose", "target_gains"):
        backend.said(topic).clear()
    backend.see(stamp)  # the backend asks again
    backend.wait(lambda: backend.said("target_pose") and backend.said("target_gains") and backend.said("episode/tick"))
    assert (
        {s for s, _ in backend.ticks()}
        == {stamp}
        == {stamp_nanoseconds(m.header.stamp) for m in backend.said("target_pose")}
    )


def test_a_plan_that_got_lost_is_given_again(begin):
    """To a controller that joined too late to hear it, say."""
    backend = begin()
    stamp = backend.tick(1)
    backend.goal(stamp)
    backend.stand(stamp)
    backend.see(stamp)
    backend.start()
    backend.wait(lambda: backend.said("joint_trajectory"), "the plan")
    plan = backend.said("joint_trajectory")[0]
    backend.said("joint_trajectory").clear()
    backend.wait(lambda: backend.said("joint_trajectory"), "the plan again")  # the backend repeats what it said
    assert backend.said("joint_trajectory")[0] == plan


def test_a_backend_that_was_restarted_may_give_a_goal_of_the_same_stamp(begin):
    """Each begins at 0 s and its first episode a tick later; the goal of 0 s is lost on who was busy meanwhile, for one is latched."""
    backend = begin()
    run_to_post(backend, 1)
    for topic in ("goal_keypoints", "episode/tick"):
        backend.said(topic).clear()
    backend.forget()
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
    backend.wait(lambda: backend.said("approach/refusal"))
    refusal = backend.said("approach/refusal")[-1]
    assert stamp_nanoseconds(refusal.header.stamp) == backend.tick(1)
    assert backend.phases()[-1] == PhaseState("failed", f"approach: {refusal_reason(refusal)}")
    assert not backend.ticks() and not backend.said("joint_trajectory")


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


def test_in_real_time_nobody_is_waited_for_and_a_silent_camera_ends_the_episode(begin):
    backend = begin(mode="realtime", silence=4.0, settle=0.0)  # more than a busy machine is silent
    backend.goal(backend.tick(1))
    backend.start()
    began, frames = backend.graph.seconds, []

    def stream_until(condition, what):
        def step():
            passed = len(frames) * TICK // 3
            if backend.graph.seconds - began >= passed / 1e9:
                stamp = backend.tick(1) + passed
                frames.append(stamp)
                backend.stand(stamp - 1, backend.joints)  # the newest state, not one of the image's stamp
                backend.see(stamp)
            return condition()

        backend.probe.wait_until(step, what=what)

    backend.joints = NOMINAL.ready
    stream_until(lambda: backend.phase() == "approach" and backend.said("joint_trajectory"), "the plan")
    assert {phase for _, phase in backend.ticks()} >= {"pre"}  # ticks went on while the planner thought
    backend.joints = trajectory_arrays(backend.said("joint_trajectory")[0], JOINT_NAMES)[1][-1]
    stream_until(lambda: len(backend.said("target_pose")) >= 3 and backend.said("target_gains"), "targets")
    stamps = [stamp for stamp, _ in backend.ticks()]
    assert (np.diff(stamps) >= 0.9 * TICK).all()
    assert {stamp_nanoseconds(m.header.stamp) for m in backend.said("target_pose")} <= set(stamps)
    backend.probe.wait_until(lambda: backend.phase() == "failed: post: no keypoints within 4 s", what="its end")


def test_in_real_time_an_episode_does_not_begin_with_what_a_silent_camera_saw(begin):
    """Long ago, and the object may be anywhere."""
    backend = begin(mode="realtime", silence=1.0)
    backend.goal(backend.tick(1))
    backend.stand(backend.tick(2))
    for number in range(3):
        backend.see(backend.tick(2) + number)
    seen = backend.graph.seconds
    backend.probe.wait_until(lambda: backend.graph.seconds > seen + 2.0)
    backend.start()
    backend.probe.wait_until(lambda: backend.phase().startswith("failed"), what="the end")
    assert backend.phase() == "failed: pre: no keypoints within 1 s"
    assert not (backend.said("pre_contact_pose") or backend.said("joint_trajectory") or backend.ticks())


def test_in_real_time_a_busy_pre_contact_does_not_take_what_was_seen_before_the_start_for_news(begin):
    """Both wait for it: what was seen, and then the start."""
    backend = begin(mode="realtime", silence=60.0)
    backend.goal(backend.tick(1))
    with backend.graph.frozen("pre_contact"):
        backend.see(backend.tick(2))
        backend.start()
        backend.probe.wait_until(lambda: backend.phase() == "pre", what="the start")
    backend.said("diagnostics").clear()

    def spoke():
        return any(s.name == "/pre_contact" for array in backend.said("diagnostics") for s in array.status)

    backend.probe.wait_until(spoke, what="pre_contact to go on")
    assert not backend.said("pre_contact_pose")


def test_in_real_time_a_backend_that_falls_silent_ends_the_episode(begin):
    backend = begin(mode="realtime", silence=60.0)
    status = DiagnosticStatus(name="/sim_bridge", level=DiagnosticStatus.OK, message="moving")
    backend.goal(backend.tick(1))
    backend.probe.publish("diagnostics", DiagnosticArray(status=[status]), qos.EVENT)
    backend.start()
    backend.probe.wait_until(lambda: backend.phase().startswith("failed"), what="the end")
    assert backend.phase() == "failed: pre: no diagnostics of sim_bridge within 3 s"


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
        for status in (status for array in backend.said("diagnostics") for status in array.status):
            refused[status.name] = {pair.key: pair.value for pair in status.values}.get("refused_encoding")
        return refused.get("/approach") == refused.get("/post_contact") == "1"

    backend.wait(both, "both to have refused it")

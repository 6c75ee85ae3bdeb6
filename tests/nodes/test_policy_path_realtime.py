"""pre_contact, approach, post_contact and episode in real time; the test is backend and perception."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from policy_path import TICK

from np_description.message_arrays import (
    stamp_nanoseconds,
    trajectory_arrays,
)
from np_description.panda import JOINT_NAMES, NOMINAL
from np_ros import qos


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
    stream_until(lambda: backend.phase() == "approach" and backend.received("joint_trajectory"), "the plan")
    assert {phase for _, phase in backend.ticks()} >= {"pre"}  # ticks went on while the planner thought
    backend.joints = trajectory_arrays(backend.received("joint_trajectory")[0], JOINT_NAMES)[1][-1]
    stream_until(lambda: len(backend.received("target_pose")) >= 3 and backend.received("target_gains"), "targets")
    stamps = [stamp for stamp, _ in backend.ticks()]
    assert (np.diff(stamps) >= 0.9 * TICK).all()
    assert {stamp_nanoseconds(m.header.stamp) for m in backend.received("target_pose")} <= set(stamps)
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
    assert not (backend.received("pre_contact_pose") or backend.received("joint_trajectory") or backend.ticks())


def test_in_real_time_no_plan_begins_where_the_arm_was_before_the_backend_was_restarted(begin):
    """The newest state is later than any of the new backend, whose time begins anew."""
    backend = begin(mode="realtime", silence=60.0)
    before, now = NOMINAL.ready + 0.2, NOMINAL.ready
    backend.goal(backend.tick(51))
    backend.see(backend.tick(52))
    backend.stand(backend.tick(52) + 1, before)
    backend.restart()
    backend.goal(backend.tick(1))
    began, frames = backend.graph.seconds, []

    def stream_until(condition, what, joints=None):
        def step():
            passed = len(frames) * TICK // 3
            if backend.graph.seconds - began >= passed / 1e9:
                frames.append(backend.tick(2) + passed)
                backend.see(frames[-1])
                if joints is not None:
                    backend.stand(frames[-1], joints)
            return condition()

        backend.probe.wait_until(step, what=what)

    stream_until(lambda: len(frames) > 3, "frames without a state")
    backend.start()
    stream_until(lambda: backend.received("pre_contact_pose"), "the contact")
    last = len(frames) + 6
    stream_until(lambda: len(frames) > last, "frames with a plan wanted")
    assert not backend.received("joint_trajectory")
    stream_until(lambda: backend.received("joint_trajectory"), "the plan", now)
    assert trajectory_arrays(backend.received("joint_trajectory")[0], JOINT_NAMES)[1][0] == pytest.approx(now)


def test_in_real_time_a_busy_pre_contact_does_not_take_what_was_seen_before_the_start_for_news(begin):
    """Both wait for it: what was seen, and then the start."""
    backend = begin(mode="realtime", silence=60.0)
    backend.goal(backend.tick(1))
    with backend.graph.frozen("pre_contact"):
        backend.see(backend.tick(2))
        backend.start()
        backend.probe.wait_until(lambda: backend.phase() == "pre", what="the start")
    backend.received("diagnostics").clear()

    def spoke():
        return any(s.name == "/pre_contact" for array in backend.received("diagnostics") for s in array.status)

    backend.probe.wait_until(spoke, what="pre_contact to go on")
    assert not backend.received("pre_contact_pose")


def test_in_real_time_a_backend_that_falls_silent_ends_the_episode(begin):
    backend = begin(mode="realtime", silence=60.0)
    status = DiagnosticStatus(name="/sim_bridge", level=DiagnosticStatus.OK, message="moving")
    backend.goal(backend.tick(1))
    backend.probe.publish("diagnostics", DiagnosticArray(status=[status]), qos.EVENT)
    backend.start()
    backend.probe.wait_until(lambda: backend.phase().startswith("failed"), what="the end")
    assert backend.phase() == "failed: pre: no diagnostics of sim_bridge within 3 s"

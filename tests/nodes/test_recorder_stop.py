"""What ends a recording, whatever the clocks of the machine do."""

import json

import numpy as np
from sensor_msgs.msg import JointState

from np_description.panda import STATE_NAMES
from np_evaluation.simtest.scheduler import SECOND
from np_record.bag import Recording
from np_ros import qos
from np_ros.messages import joint_state_message, pose_message

PERIOD = 2_000_000


def test_a_wall_clock_that_is_set_back_during_a_stop_does_not_hold_it_up(graph, probe, tmp_path):
    probe.advertise("joint_states", JointState, qos.RECORDER)
    graph.run("np_record", "recorder", {"bag": str(tmp_path / "bag"), "record_at_start": False})
    probe.wait_until(lambda: probe.matched("joint_states"))
    assert probe.call("recorder/start").success
    origin = pose_message(0, "panda_link0", np.zeros(3), np.array([1.0, 0, 0, 0]))
    probe.publish("goal_pose", origin, qos.LATCHED)
    sent = []

    def send():
        sent.append(len(sent) * PERIOD)
        probe.publish("joint_states", joint_state_message(sent[-1], STATE_NAMES, *np.zeros((3, 9))), qos.RECORDER)

    probe.node.create_timer(0.002, send)
    probe.wait_until(lambda: len(sent) > 100)
    before, begun = len(sent), graph.seconds
    graph.scheduler.call_after(
        SECOND // 10, lambda: setattr(graph.scheduler, "wall_offset", graph.scheduler.wall_offset - 20 * SECOND)
    )
    answer = probe.call("recorder/stop")
    assert answer.success and graph.seconds - begun < 2.0
    with Recording(json.loads(answer.message)["bag"]) as recording:
        assert recording.counts["joint_states"] >= before - 1

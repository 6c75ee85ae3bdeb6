"""The recorder as a process: nothing is lost, however it is ended."""

import json
import resource
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from graph_tools import TIMEOUT
from rclpy.duration import Duration
from sensor_msgs.msg import JointState

from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_description.phases import PhaseState
from np_record.bag import Recording
from np_record.bag_writer import INCOMPLETE
from np_ros import qos
from np_ros.messages import joint_state_message, pose_message
from np_ros.phases import phase_message, phase_state
from np_ros.processes.supervisor import NodeDied

PERIOD = 2_000_000


def publish_run(probe, start, count, phase=PhaseState("post")):
    """`count` states and answers from step `start`, with a phase after the first."""
    for step in range(start, start + count):
        values = np.full((3, 9), float(step))
        probe.publish("joint_states", joint_state_message(step * PERIOD, STATE_NAMES, *values), qos.RECORDER)
        probe.publish("effort_command", joint_state_message(step * PERIOD, JOINT_NAMES, *values[:, :7]), qos.RECORDER)
        if step == start:
            probe.publish("episode/phase", phase_message(phase), qos.LATCHED)
    topics = ("joint_states", JointState), ("effort_command", JointState), ("episode/phase", DiagnosticArray)
    for topic, kind in topics:
        assert probe.advertise(topic, kind).wait_for_all_acked(Duration(seconds=TIMEOUT))


@pytest.fixture
def recorder(graph, probe, tmp_path):
    def start(**parameters):
        graph.run("np_record", "recorder", {"bag": str(tmp_path / "bag"), **parameters})
        for topic, kind, profile in (
            ("joint_states", JointState, qos.RECORDER),
            ("effort_command", JointState, qos.RECORDER),
            ("episode/phase", DiagnosticArray, qos.LATCHED),
            ("goal_pose", PoseStamped, qos.LATCHED),
        ):
            probe.advertise(topic, kind, profile)
        probe.wait_until(
            lambda: all(map(probe.matched, ("joint_states", "effort_command", "episode/phase", "goal_pose"))),
            what="the recorder's subscriptions",
        )
        probe.be_found("recorder")
        return tmp_path / "bag_000"

    return start


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_everything_is_in_the_bag_when_the_recorder_is_ended(graph, probe, recorder, end):
    bag = recorder(run_info=json.dumps({"seed": 7}))
    publish_run(probe, 0, 1500)
    assert graph.kill("recorder", end) == 0
    with Recording(bag) as recording:
        assert recording.counts["joint_states"] == recording.counts["effort_command"] == 1500
        assert recording.information == {"seed": 7}
        assert [m.stamp for m in recording.messages("joint_states")] == [i * PERIOD for i in range(1500)]
        assert [(m.stamp, phase_state(m.decode())) for m in recording.messages("episode/phase")] == [
            (0, PhaseState("post"))
        ]


def test_a_disk_that_becomes_full_ends_the_recorder_by_name_and_the_bag_can_be_read(graph, probe, recorder):
    bag = recorder()
    said = probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    probe.wait_until(lambda: said)
    resource.prlimit(graph.pid("recorder"), resource.RLIMIT_FSIZE, (3 << 19, 3 << 19))  # a chunk and a half
    publish_run(probe, 0, 4000)
    told = f"bag {bag}: cannot be written: File too large; it ends early, readable, with "
    with pytest.raises(NodeDied, match="recorder ended with status 1") as died:
        probe.wait_until(lambda: False)
    assert told in str(died.value) and "Traceback" not in str(died.value)
    for _ in range(100):  # what was said before the end may still have to be taken
        if errors := [s for m in said for s in m.status if s.level == DiagnosticStatus.ERROR and told in s.message]:
            break
        probe.spin_once()
    assert errors
    with Recording(bag) as recording:
        assert recording.counts["joint_states"] > 500 and "File too large" in recording.information[INCOMPLETE]
        stamps = [m.stamp for m in recording.messages("joint_states")]
        assert stamps == [i * PERIOD for i in range(len(stamps))]


def test_one_bag_for_each_start_and_stop(graph, probe, recorder):
    recorder(record_at_start=False, required="joint_states,episode/tick")
    refused = probe.call("recorder/start")
    assert not refused.success and refused.message == "no publisher yet of episode/tick"
    assert not probe.call("recorder/stop").success
    probe.advertise("episode/tick", DiagnosticArray)
    probe.wait_until(lambda: probe.matched("episode/tick"))
    digests = []
    for start in (0, 500):
        probe.wait_until(lambda: probe.call("recorder/start").success)
        publish_run(probe, start, 1)
        pose = pose_message((start + 5) * PERIOD, "panda_link0", np.zeros(3), np.array([1.0, 0, 0, 0]))
        probe.publish("goal_pose", pose, qos.LATCHED)
        publish_run(probe, start + 5, 100)
        answer = probe.call("recorder/stop")
        result = json.loads(answer.message)
        assert answer.success and (result["lost"], result["repeated"]) == (0, 0)
        with Recording(result["bag"]) as recording:
            assert recording.start == (start + 5) * PERIOD and recording.counts["joint_states"] == 100
            digests.append(recording.digest())
    assert digests[0] != digests[1]


def test_a_stop_is_answered_while_the_arm_goes_on_sending(probe, recorder):
    recorder(record_at_start=False)
    assert probe.call("recorder/start").success
    sent = []

    def send():
        sent.append(len(sent) * PERIOD)
        probe.publish("joint_states", joint_state_message(sent[-1], STATE_NAMES, *np.zeros((3, 9))), qos.RECORDER)

    origin = pose_message(0, "panda_link0", np.zeros(3), np.array([1.0, 0, 0, 0]))
    probe.publish("goal_pose", origin, qos.LATCHED)
    timer = probe.node.create_timer(0.002, send)
    probe.wait_until(lambda: len(sent) > 100, what="a hundred states")
    before = len(sent)
    answer = probe.call("recorder/stop")
    timer.cancel()
    assert answer.success
    with Recording(json.loads(answer.message)["bag"]) as recording:
        assert before - 1 <= recording.counts["joint_states"] <= len(sent)  # the first may come before the goal


def test_a_parameter_that_it_does_not_have_begins_no_bag(graph, probe, tmp_path):
    with pytest.raises(NodeDied, match="parameter modus: not one of this node's"):
        graph.run("np_record", "recorder", {"bag": str(tmp_path / "bag"), "modus": "realtime"})
        probe.wait_until(lambda: False)
    assert not list(tmp_path.glob("bag*"))

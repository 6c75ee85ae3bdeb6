"""The simulated network, faults and invariants: runs are deterministic, guarantees hold, and violations are found."""

from contextlib import suppress
from dataclasses import replace
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.node import Node
from std_msgs.msg import Float64

from np_control.safety import LIMITS
from np_evaluation.simtest.endpoints import TopicFault
from np_evaluation.simtest.faults import InjectedFault
from np_evaluation.simtest.fidelity import compare, find_differences
from np_evaluation.simtest.network import Network
from np_evaluation.simtest.over_dds import select_playable
from np_evaluation.simtest.plan import Plan
from np_evaluation.simtest.process import Process
from np_evaluation.simtest.relay import Relay
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, _TurnQueue, simulate_host
from np_evaluation.simtest.shrink import play, shrink
from np_ros import qos
from np_ros.processes.graph import NodeSpec


class Talker(Node):
    """Publishes a number every 10 ms and subscribes to the same topic."""

    profile = qos.LOCKSTEP, qos.LOCKSTEP

    def __init__(self):
        super().__init__("talker")
        self.received = []
        self._publisher = self.create_publisher(Float64, "numbers", self.profile[0])
        self.create_subscription(Float64, "numbers", lambda m: self.received.append(m.data), self.profile[1])
        self.create_timer(0.01, self._publish)
        self._number = 0.0

    def _publish(self):
        self._number += 1.0
        self._publisher.publish(Float64(data=self._number))


class BestEffort(Talker):
    """The same with the profiles of real time."""

    profile = qos.REALTIME_PUBLISHER, qos.REALTIME_SUBSCRIBER


def run_talker(kind, topic_fault=None, seconds=2.0, act=lambda process, scheduler: None):
    scheduler = Scheduler(0)
    network = Network(scheduler)
    with simulate_host(scheduler, Locks(), Disk()):
        process = Process(network, NodeSpec("", "talker"), kind, lambda text: None, lambda: ["talker"])
        if topic_fault:
            network.topic_faults["/numbers"] = topic_fault
        scheduler.run_until(2 * SECOND)
        act(process, scheduler)
        scheduler.run_until(2 * SECOND + round(seconds * SECOND))
    return process.node.received


def test_a_reliable_topic_loses_nothing_and_keeps_its_order():
    received = run_talker(Talker, TopicFault(loss=0.9))
    assert len(received) > 100 and np.diff(received).tolist() == [1.0] * (len(received) - 1)


def test_a_best_effort_topic_loses_messages_but_keeps_their_order():
    received = run_talker(BestEffort, TopicFault(loss=0.5))
    assert 50 < len(received) < 150 and min(np.diff(received)) > 0 and max(np.diff(received)) > 1


def test_a_frozen_process_receives_as_many_messages_as_the_depth_keeps():
    def freeze(process, scheduler):
        process.freeze()
        scheduler.call_at(scheduler.now + SECOND, process.thaw)

    assert max(np.diff(run_talker(Talker, act=freeze))) == 1.0
    # A frozen process publishes nothing; one message may have been in transit.
    assert len(run_talker(BestEffort, act=freeze)) <= len(run_talker(BestEffort))


def test_a_killed_process_publishes_nothing_more():
    received = run_talker(Talker, act=lambda process, scheduler: process.kill())
    assert len(received) < 110


def test_a_recorder_killed_while_it_closes_its_bag_does_not_continue():
    """Its callback sleeps during the kill and then writes, but no consumer is left."""
    queue, taken = _TurnQueue(), []

    def take():
        with suppress(SystemExit):  # pytest reports an exception of a thread
            taken.append(queue.get())
            queue.get()

    thread = Thread(target=take)
    thread.start()
    queue.put("message")
    queue.kill()
    thread.join(10)
    with pytest.raises(SystemExit):
        queue.put("another")
    assert taken == ["message"] and not thread.is_alive()


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_run_is_deterministic(mode):
    plan = replace(Plan.of(3), mode=mode, horizon=1.0, post_timeout=0.3)
    first, second = play(plan), play(plan)
    assert first.log == second.log and first.phases == second.phases


@pytest.mark.slow
def test_a_lockstep_recording_replays():
    plan = replace(Plan.of(0), mode="lockstep", is_recorded=True, horizon=1.0, post_timeout=0.3, faults=())
    report = play(plan)
    assert not report.violations and "approach" in report.phases


def test_the_arm_stops_when_its_controller_is_killed():
    crash = InjectedFault("crash", 1.4, "joint_impedance", 1.0)
    report = play(
        replace(Plan.of(0), mode="realtime", is_recorded=False, horizon=2.5, post_timeout=0.3, faults=(crash,))
    )
    assert not report.violations
    assert any(phase.startswith("fault: stopped: silence") for phase in report.phases)


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
@pytest.mark.slow
def test_the_arm_comes_to_rest_when_the_episode_is_killed_in_the_approach(mode):
    crash = InjectedFault("crash", 1.0, "episode", 1.0)
    report = play(replace(Plan.of(0), mode=mode, is_recorded=False, horizon=2.5, post_timeout=0.3, faults=(crash,)))
    assert not report.violations and report.phases[:4] == ["idle", "pre", "approach", "idle"]
    assert ("joint_impedance: refused_heartbeat" in report.refusals) == (mode == "realtime")


@pytest.mark.slow
def test_no_motion_continues_after_a_reset_in_the_approach_just_after_the_episode_was_killed():
    faults = InjectedFault("crash", 1.35, "episode", 2.0), InjectedFault("request", 1.4, "sim_bridge/reset")
    report = play(replace(Plan.of(0), mode="realtime", is_recorded=False, horizon=2.5, post_timeout=0.3, faults=faults))
    assert not report.violations


@pytest.mark.slow
def test_a_reset_in_the_middle_of_a_push_leaves_the_arm_at_rest():
    """The tick of the new task's first state still has phase `post`: its target belongs to the ended episode."""
    reset = InjectedFault("request", 1.478, "sim_bridge/reset")
    report = play(replace(Plan.of(31508), is_recorded=False, faults=(reset,)))
    assert not report.violations and "post" in report.phases and "joint_impedance: refused_state" in report.refusals


@pytest.mark.slow
def test_recover_ends_the_fault_of_a_measurement_that_is_not_finite_in_lockstep():
    """Time stops while the arm is at fault: the last published state remains the invalid one."""
    broken = InjectedFault("sensor_nan", 1.053, "", 0.003)
    report = play(replace(Plan.of(40043), is_recorded=False, faults=(broken,)))
    assert not report.violations and any("reflex: force: no estimate" in phase for phase in report.phases)


def test_a_wall_clock_set_back_ends_no_episode():
    jump = InjectedFault("clock_jump", 0.8, "", 0.0, -4.0)
    report = play(
        replace(Plan.of(0), mode="realtime", is_recorded=False, horizon=1.5, post_timeout=3.5, faults=(jump,))
    )
    assert not report.violations
    assert report.phases[-1].partition(": no ")[0] in ("succeeded", "failed: post: timeout")


def test_a_restarted_backend_publishes_an_accepted_goal_after_the_wall_clock_was_set_back():
    jump = InjectedFault("clock_jump", 0.8, "", 0.0, -20.0)
    crash = InjectedFault("crash", 1.0, "sim_bridge", 0.3)
    report = play(
        replace(Plan.of(0), mode="realtime", is_recorded=False, horizon=2.0, post_timeout=0.3, faults=(jump, crash))
    )
    assert not report.violations and "episode: refused_order" not in report.refusals


def test_a_disabled_guard_is_found_and_its_run_shrunk(monkeypatch):
    """A backend that stops neither without commands nor at high force breaks an invariant; of three faults the crash of the controller remains."""
    from np_control.force_watch import ForceWatch
    from np_control.safety.watchdog import Watchdog

    create = ForceWatch.__init__
    monkeypatch.setattr(Watchdog, "poll", lambda self, now: self.state)
    monkeypatch.setattr(ForceWatch, "__init__", lambda self, mode: create(self, "observe"))
    crash = InjectedFault("crash", 1.4, "joint_impedance", 3.0)
    others = InjectedFault("duplicates", 1.0, "target_pose", 0.5, 0.5), InjectedFault("clock_jump", 1.2, "", 0.0, 3.0)
    report = play(
        replace(Plan.of(0), mode="realtime", is_recorded=False, horizon=2.0, post_timeout=0.3, faults=(*others, crash))
    )
    assert "rest" in report.violations
    assert [fault.kind for fault in shrink(report).plan.faults] == ["crash"]


def test_a_torque_beyond_the_limits_is_found(monkeypatch):
    from np_control.safety.filter import SafetyFilter

    apply = SafetyFilter.apply
    monkeypatch.setattr(
        SafetyFilter,
        "apply",
        lambda self, now, q, dq: replace(apply(self, now, q, dq), torque=1.01 * LIMITS.torque),
    )
    assert "torque" in play(replace(Plan.of(0), mode="realtime", is_recorded=False, faults=())).violations


@pytest.mark.slow
def test_a_dozen_seeds_keep_the_guarantees():
    broken = {seed: report.violations for seed in range(12) if (report := play(Plan.of(seed))).violations}
    assert not broken


def test_a_fault_inside_a_process_is_left_out_over_dds():
    jump, crash = InjectedFault("clock_jump", 0.8, "", 0.0, -4.0), InjectedFault("crash", 1.0, "episode", 0.3)
    plan = select_playable(replace(Plan.of(0), is_recorded=True, faults=(jump, crash)))
    assert plan.faults == (crash,) and not plan.is_recorded


def test_differences_are_what_no_simulated_run_had_and_what_each_of_them_had():
    real, simulated = {"faults": {"silence", "stop"}}, [{"faults": {"stop", "force"}}, {"faults": {"force", "reset"}}]
    assert find_differences(real, simulated) == {"faults": {"only_over_dds": ["silence"], "only_in_process": ["force"]}}
    assert find_differences(real, [*simulated, real]) == {}


def test_counts_of_an_ended_node_are_no_difference():
    simulated = [{"refusals": {"episode: refused_order", "approach: refused_finite"}}]
    found = find_differences({"refusals": set()}, simulated, incomplete=["episode"])
    assert found == {"refusals": {"only_over_dds": [], "only_in_process": ["approach: refused_finite"]}}


def test_refusals_of_a_run_without_faults_are_no_difference():
    simulated = [{"refusals": {"sim_bridge: refused_late", "approach: refused_finite"}}]
    found = find_differences({"refusals": set()}, simulated, usual=["sim_bridge: refused_late"])
    assert found == {"refusals": {"only_over_dds": [], "only_in_process": ["approach: refused_finite"]}}


class Wire(Node):
    """Replaces the node of a relay: keeps the published messages and the relay's callback."""

    def __init__(self):
        self.published = []

    def create_publisher(self, kind, topic, profile):
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, callback, profile, raw):
        self.deliver, self.topic = callback, topic


def test_a_relay_keeps_the_order_of_delayed_messages_and_drops_lost_ones():
    network, wire = Network(Scheduler(0)), Wire()
    Relay(wire, "joint_states", network, is_lockstep=False)
    assert wire.topic == "joint_states_before_faults"
    wire.deliver(b"1")
    network.topic_faults["/joint_states"] = TopicFault(delay=SECOND)
    wire.deliver(b"2")
    network.topic_faults["/joint_states"] = TopicFault(loss=1.0)
    wire.deliver(b"3")
    network.topic_faults.clear()
    wire.deliver(b"4")
    assert wire.published == [b"1"]
    network.scheduler.run_until(3 * SECOND)
    assert wire.published == [b"1", b"2", b"4"]


@pytest.mark.slow
def test_a_script_has_the_same_outcome_over_dds():
    faults = InjectedFault("nan", 0.65, "keypoints", 1.3), InjectedFault("request", 2.0, "sim_bridge/stop")
    row, log = compare(replace(Plan.of(0), mode="lockstep", horizon=2.0, post_timeout=0.3, faults=faults))
    assert not row["violations"] and "faults" not in row["differs"], log
    assert "fault: stopped: stop requested" in row["phases"], log
    assert any(key.endswith("refused_finite") for key in row["refusals"]), log

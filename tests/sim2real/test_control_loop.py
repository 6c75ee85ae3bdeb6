"""What breaks the control loop: each cause is found by its own measurement, and nothing is called good that was not measured."""

import json
from dataclasses import fields, replace
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import record as recorded_arm
from bags import record_episode
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from sim2real.cli import diagnose_task
from sim2real.diagnosis import diagnose
from sim2real.recordings.loop_record import LoopRecord, NodeReports, collect_reports
from sim2real.recordings.loop_timing import LOOP, explain_effect, find_loop_timing
from sim2real.recordings.reading import ContractViolation, load_bag
from sim2real.recordings.signals import Commands
from sim2real.report.control_loop import describe_loops

BESIDE = ("camera/image_raw", "keypoints", "object_pose", "external_wrench", "episode/tick")  # what the loop is without
DURATION, PERIOD = 60.0, 0.002
RNG = np.random.default_rng(5)
REPORTED = np.arange(0.3, DURATION, 1.0)
GREW = np.ones(len(REPORTED))


def reports(words="moving: commanded\nstate: moving", **values):
    texts = words if isinstance(words, tuple) else (words,) * len(REPORTED)
    return NodeReports(
        REPORTED, {key: np.broadcast_to(np.asarray(v, float), REPORTED.shape) for key, v in values.items()}, texts
    )


def counted(per_report):
    """A count that grows by so much (d,) until each report, and was 7 before."""
    return 7 + np.cumsum(per_report * GREW)


def record(losses=(), wait=None, overrun=None, words="moving: commanded\nstate: moving", **values):
    """A loop in which the driver loses cycles at `losses` (s, count), counted in the report after the next. wait, overrun: (d,) ms more
    by report than usual."""
    seen, lost = np.ones(round(DURATION / LOOP.cycle), bool), np.zeros(len(REPORTED))
    for time, count in losses:
        seen[round(time / LOOP.cycle) :][:count] = False
        lost[np.searchsorted(REPORTED, time) + 1] += count
    stamps = np.arange(0.0, DURATION, PERIOD)[seen.reshape(-1, 2).any(axis=1)]
    usual = 0.3 + 0.1 * RNG.random(len(REPORTED))
    driver = reports(
        words,
        **{
            "lost_cycles": counted(lost),
            "commands": counted(500 * GREW),
            "command_success_rate": 1.0,
            "reply_p99_ms": 0.2,
            "overrun_ms": counted(0.0 if overrun is None else overrun),
            "processor_wait_ms": counted(usual + (0.0 if wait is None else wait)),
            **values,
        },
    )
    controller = reports(answer_p50_ms=0.3, answer_p99_ms=0.6, processor_wait_ms=counted(usual))
    return LoopRecord(stamps, stamps, nodes={"franka_driver": driver, "joint_impedance": controller})


def near(losses, share=1.0):
    """(d,) ms that a cause takes of the robot's cycles, in the report after each loss."""
    taken = np.zeros(len(REPORTED))
    for time, count in losses:
        taken[np.searchsorted(REPORTED, time)] += share * count
    return taken


def late(values):
    """(d,) the same a report later, with the count of the loss."""
    return np.r_[0.0, values[:-1]]


def with_node(of, name, **values):
    node = of.nodes[name]
    return replace(of, nodes={**of.nodes, name: replace(node, values={**node.values, **values})})


def only_fault(of):
    timing = find_loop_timing(of)
    (fault,) = timing.faults
    return timing, fault


def test_a_loop_that_loses_nothing_is_steady():
    timing = find_loop_timing(record())
    assert (timing.status, timing.faults, timing.broken_sentence) == ("steady", (), "")
    assert (timing.lost_cycles, timing.in_a_row, timing.late_share, timing.success_rate) == (0, 0, 0.0, 1.0)


def test_single_lost_cycles_are_no_disturbance():
    assert find_loop_timing(record([(5.0 + n, 1) for n in range(50)])).status == "steady"


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.integers(2, 55), st.integers(LOOP.burst + 2, 60)), min_size=1, max_size=5, unique_by=lambda p: p[0]
    ),
    st.sampled_from(["network", "busy_machine", "computation"]),
    st.integers(0, 30),
)
def test_the_cause_is_what_accounts_for_the_lost_cycles(losses, cause, offset):
    losses = [(second + 0.31 + 0.01 * offset, count) for second, count in losses]
    times = near(losses)
    of = record(
        losses,
        wait=times if cause == "busy_machine" else None,
        overrun={"network": None, "busy_machine": late(times), "computation": late(times)}[cause],
    )
    timing, fault = only_fault(of)
    assert (fault.what, fault.cause) == ("lost_cycles", cause)
    longest = max(count for _, count in losses)
    assert timing.lost_cycles == sum(count for _, count in losses)
    assert longest - 2 <= timing.in_a_row <= longest
    assert fault.is_broken == (timing.in_a_row >= 20) == bool(timing.broken_sentence)
    assert timing.status == ("broken" if fault.is_broken else "disturbed")
    shown = {"busy_machine": fault.sentence.split("waited ")[-1], "computation": fault.sentence.split("worked ")[-1]}
    if cause != "network":
        assert float(shown[cause].split(" ms")[0]) == pytest.approx(timing.lost_cycles, abs=3)


def test_a_cause_that_accounts_for_less_than_half_is_none():
    losses = [(10.5, 12), (30.5, 15)]
    assert only_fault(record(losses, wait=near(losses, 0.3)))[1].cause == "network"
    assert only_fault(record(losses, overrun=late(near(losses, 0.3))))[1].cause == "network"
    elsewhere = near([(45.5, 100)])
    assert only_fault(record(losses, wait=elsewhere, overrun=elsewhere))[1].cause == "network"


@pytest.mark.parametrize("key", ["overrun_ms", "processor_wait_ms"])
def test_without_the_measurement_the_cause_is_not_named(key):
    of = record([(10.5, 12)])
    values = dict(of.nodes["franka_driver"].values)
    del values[key]
    driver = replace(of.nodes["franka_driver"], values=values)
    _, fault = only_fault(replace(of, nodes={**of.nodes, "franka_driver": driver}))
    assert fault.cause == "undetermined" and key in fault.sentence


def test_a_motion_that_the_robot_ended_is_broken_and_an_older_error_is_not():
    error = 'last_error: motion aborted by reflex! ["communication_constraints_violation"]'
    before, after = ("moving\nstate: moving",) * 30, (f"fault\nstate: fault\n{error}",) * (len(REPORTED) - 30)
    timing, fault = only_fault(record([(28.5, 3)], words=before + after))
    assert fault.is_broken and "the robot ended the motion" in timing.broken_sentence
    assert find_loop_timing(record(words=f"moving\nstate: moving\n{error}")).status == "steady"


@pytest.mark.parametrize("reply, cause", [(0.2, "network"), (0.8, "computation")])
def test_commands_that_miss_the_robot_are_late_or_lost_on_the_way(reply, cause):
    timing, fault = only_fault(record(command_success_rate=0.9, reply_p99_ms=reply))
    assert (fault.what, fault.cause, timing.status) == ("low_success", cause, "broken")
    assert f"{reply} ms" in fault.sentence and "90.0 %" in timing.broken_sentence


def test_the_robot_reports_no_success_while_it_is_not_controlled():
    rate = np.where(REPORTED < 20, 0.0, 0.99)
    timing = find_loop_timing(record(command_success_rate=rate))
    assert timing.status == "steady" and timing.success_rate == pytest.approx(0.99)


def unanswered(of, begin=20.0, end=40.0, every=10):
    """Every tenth state of some seconds has no command: 5 % of them, 50 ms a second."""
    here = (of.states >= begin) & (of.states < end)
    return replace(of, commands=of.states[~(here & (np.arange(len(of.states)) % every == 0))])


@pytest.mark.parametrize("cause", ["busy_machine", "computation", "messages"])
def test_states_without_a_command_have_a_cause_too(cause):
    of, during = unanswered(record()), (REPORTED > 20) & (REPORTED < 42)
    values = of.nodes["joint_impedance"].values
    if cause == "busy_machine":
        more = {"processor_wait_ms": values["processor_wait_ms"] + np.cumsum(np.where(during, 100.0, 0.0))}
        of = with_node(of, "joint_impedance", **more, answer_p99_ms=np.where(during, 8.0, 0.6))
    elif cause == "computation":
        of = with_node(of, "joint_impedance", answer_p99_ms=np.where(during, 4.0, 0.6))
    timing, fault = only_fault(of)
    assert (fault.what, fault.cause, fault.is_broken) == ("late_commands", cause, False)
    assert timing.late_share == pytest.approx(1000 / 30000, rel=0.01) and "1000 of" in fault.sentence
    assert timing.broken_sentence == ""


def test_silence_that_stops_the_arm_is_broken():
    before, after = ("moving\nstate: moving",) * 30, ("stopped: silence: no command for 200 ms\nstate: stopped",)
    timing, fault = only_fault(record(words=before + after * (len(REPORTED) - 30)))
    assert fault.what == "late_commands" and fault.is_broken and "200 ms" in timing.broken_sentence
    of = record(words=(*after, *before * 3)[: len(REPORTED)])
    assert find_loop_timing(of).status == "steady"  # it was before the recording


def test_a_policy_that_is_late_or_leaves_targets_out():
    of, targets = record(), np.arange(5.0, 50.0, 0.1)
    assert find_loop_timing(replace(of, targets=targets, sent=targets + 0.03)).status == "steady"
    paused = np.r_[targets, targets + 60.0]  # the pause between two episodes is no gap
    assert find_loop_timing(replace(of, targets=paused)).status == "steady"
    slow = np.where(np.arange(len(targets)) % 10 == 0, 0.15, 0.03)
    _, fault = only_fault(replace(of, targets=targets, sent=targets + slow))
    assert (fault.what, fault.cause) == ("late_targets", "policy") and "150 ms old" in fault.sentence
    _, fault = only_fault(replace(of, targets=np.delete(targets, np.arange(5, 400, 20))))
    assert fault.cause == "policy" and "left out 20 targets" in fault.sentence


def test_states_that_only_the_recording_lacks_are_not_lost_cycles():
    of = record()
    kept = np.ones(len(of.states), bool)
    kept[5000:6000] = False
    of = replace(
        of, states=of.states[kept], commands=of.commands[kept][::2]
    )  # that commands are missing shows nothing then
    assert only_fault(record([(5.5 + n, 60) for n in range(20)]))[1].what == "lost_cycles"  # 2 % of the states
    timing, fault = only_fault(of)
    assert (fault.what, fault.cause, timing.in_a_row, timing.lost_cycles) == ("lost_messages", "recorder", 0, 0)
    assert not fault.is_broken and timing.late_share is None and "lacks 1000 joint states" in fault.sentence
    driver = of.nodes["franka_driver"]
    idle, starved = (reports(processor_wait_ms=counted(ms)) for ms in (1.0, 30.0))
    assert only_fault(replace(of, nodes={"franka_driver": driver, "recorder": idle}))[1].cause == "recorder"
    assert only_fault(replace(of, nodes={"franka_driver": driver, "recorder": starved}))[1].cause == "busy_machine"


def simulated(missed, wait):
    of = record()
    bridge = reports(missed_periods=np.cumsum(missed), processor_wait_ms=counted(0.2 + wait))
    return replace(of, nodes={"sim_bridge": bridge, "joint_impedance": of.nodes["joint_impedance"]})


def test_a_simulator_that_is_late_has_waited_or_the_cause_is_not_measured():
    missed = np.where((REPORTED > 10) & (REPORTED < 30), 50.0, 0.0)
    assert find_loop_timing(simulated(0 * missed, 0.0)).status == "steady"
    assert only_fault(simulated(missed, np.where(missed > 0, 90.0, 0.0)))[1].cause == "busy_machine"
    timing, fault = only_fault(simulated(missed, 0.0))
    assert (fault.what, fault.cause, timing.status) == ("missed_periods", "undetermined", "disturbed")


def test_what_was_not_recorded_is_unknown():
    of = record()
    driver = of.nodes["franka_driver"]
    few = NodeReports(driver.time[:5], {k: v[:5] for k, v in driver.values.items()}, driver.words[:5])
    cases = {
        "the recording has no diagnostics": replace(of, nodes={}),
        "count of lost cycles": replace(of, nodes={"other_driver": reports(state=np.nan)}),
        "effort_command was not recorded": replace(of, commands=np.zeros(0)),
        "cover only 4 of 60 s": replace(of, nodes={"franka_driver": few}),
    }
    for reason, case in cases.items():
        timing = find_loop_timing(case)
        assert timing.status == "unknown" and reason in timing.reason and not timing.broken_sentence


def test_lockstep_is_not_judged():
    of = unanswered(record())
    lockstep = replace(of, nodes={"sim_bridge": reports("moving\nmode: lockstep", missed_periods=50 * GREW.cumsum())})
    timing = find_loop_timing(lockstep)
    assert (timing.status, timing.faults) == ("lockstep", ())


def driven(path, lost=(), leave_out=BESIDE):
    """A bag of 6 s with a driver that reports, and loses the cycles of these steps; each second it says what it lost in the one before."""
    reports = {}
    for step in range(100, 3000, 500):
        count = 2 * sum(at < step - 500 for at in lost)
        driver = {"state": "moving", "lost_cycles": count, "overrun_ms": 0.0, "processor_wait_ms": 0.1}
        reports[step] = {"franka_driver": {**driver, "command_success_rate": 1.0, "commands": 500}}
    return record_episode(path, 3000, information={"seed": 0}, lost=lost, reports=reports, leave_out=leave_out)


def test_a_bag_shows_when_the_driver_lost_cycles(tmp_path):
    lost = range(1500, 1512)
    timing = load_bag(driven(tmp_path / "lossy", lost)).loop
    (fault,) = timing.faults
    assert (fault.what, fault.cause, timing.lost_cycles, timing.status) == ("lost_cycles", "network", 24, "broken")
    assert 22 <= timing.in_a_row <= 24 and timing.state_gaps == pytest.approx(np.array([[2.998, 26.0]]))
    assert (timing.command_gaps == timing.state_gaps).all()
    assert load_bag(driven(tmp_path / "well")).loop.status == "steady"


def test_the_report_of_the_chain_judges_the_loop_too(tmp_path, capsys):
    bags = [driven(tmp_path / name, lost, leave_out=()) for name, lost in (("well", ()), ("lossy", range(1500, 1512)))]
    assert diagnose_task.main([*map(str, bags), "--out", str(tmp_path / "out")]) == 0
    first, *_, last = capsys.readouterr().out.splitlines()
    said = "The control loop broke. The driver lost 24 cycles"
    assert said in first and first.count("control loop") == 1
    steady, broken = json.loads(last)["control_loop"]
    assert (steady["bag"], steady["status"]) == ("well", "steady")
    assert (broken["status"], broken["lost_cycles"], broken["faults"][0]["cause"]) == ("broken", 24, "network")
    page = (tmp_path / "out" / "task.html").read_text()
    loops = page.split("<h2>Timing of the control loop</h2>")[1]
    assert "well: Steady" in loops and "Broken.</span> The driver lost 24 cycles" in loops and loops.count("<svg") == 2
    assert said in page.split("<table>")[0]


def test_a_recording_that_lacks_too_much_is_refused_with_the_cause(tmp_path):
    with pytest.raises(ContractViolation, match="at most 2% missing.*lost 240 cycles.*Likely cause: network or kernel"):
        load_bag(driven(tmp_path / "bad", range(1500, 1620)))


def test_counts_are_read_from_messages_and_survive_a_restart():
    def message(name, values):
        pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
        return [SimpleNamespace(name=name, message="running", values=pairs)]

    rows = [{"lost_cycles": "5", "mode": "realtime"}, {"lost_cycles": "9"}, {"refused_late": "2"}, {"lost_cycles": "3"}]
    found = collect_reports([(float(n), message("/left/franka_driver", row)) for n, row in enumerate(rows)])
    node = found["franka_driver"]
    assert node.growth("lost_cycles").tolist() == [0, 4, 0, 3] and node.growth("refused_late").tolist() == [0, 0, 2, 0]
    assert node.latest("lost_cycles").tolist() == [5, 9, 9, 3] and node.words[0] == "running\nmode: realtime"


def test_lost_states_and_unanswered_ones_are_no_effect_of_the_arm():
    """The last command stays in force meanwhile. Some answered states stand between two that are not."""
    log, rng = recorded_arm(), np.random.default_rng(0)
    c, torque = log.commands, log.torque.copy()
    silent = np.zeros(len(log.time), bool)
    for start in rng.choice(np.arange(10, len(log.time) - 100), 18, replace=False):
        silent[start : start + 10] = True
    unanswered_ones = rng.random(len(log.time)) < 0.03
    unanswered_ones[[500, 502]], unanswered_ones[501] = True, False
    unheard = silent | unanswered_ones
    last = np.maximum.accumulate(np.where(unheard[c.rows], 0, np.arange(len(c.rows))))
    follows = c.rows + 1 < len(log.time)
    torque[c.rows[follows] + 1] += (c.torque[last] - c.torque)[follows]
    kept, rows = ~silent, ~unheard[c.rows]
    parts = {f.name: getattr(c, f.name)[rows] for f in fields(Commands) if isinstance(getattr(c, f.name), np.ndarray)}
    parts["rows"] = (np.cumsum(kept) - 1)[parts["rows"]]
    log = replace(
        log,
        time=log.time[kept],
        position=log.position[kept],
        velocity=log.velocity[kept],
        torque=torque[kept],
        torque_time=log.torque_time[kept],
        commands=replace(c, **parts),
    )
    assert diagnose([log], quick=True).verdict == "no_gap"


def test_an_effect_that_the_timing_explains_is_named():
    lossy = find_loop_timing(record(commands=counted(480 * GREW)))
    assert lossy.dropped_share == pytest.approx(0.04, abs=0.005)
    assert "did not reach the driver" in explain_effect(lossy, "packet_loss", 0.05)
    assert explain_effect(lossy, "packet_loss", 0.2) == ""
    steady = find_loop_timing(record())
    assert explain_effect(steady, "packet_loss", 0.05) == explain_effect(steady, "coulomb_friction", 0.05) == ""
    assert "0.3 ms in the median" in explain_effect(steady, "command_delay", 4e-4)
    assert explain_effect(steady, "command_delay", 4e-3) == explain_effect(steady, "command_delay", -4e-4) == ""


def test_the_report_keeps_its_schema_and_names_the_effect():
    finding = SimpleNamespace(
        effect=SimpleNamespace(id="packet_loss"), is_chosen=True, parameters={"share": SimpleNamespace(value=0.05)}
    )
    log, records = recorded_arm(), [record([(10.5, 30)], commands=counted(480 * GREW)), unanswered(record())]
    rows = describe_loops([replace(log, loop=find_loop_timing(one)) for one in records] + [log], [finding])
    schema = json.loads((files("sim2real") / "data" / "gap_report.schema.json").read_text(encoding="utf-8"))
    Draft202012Validator(schema["properties"]["control_loop"]).validate(rows)
    assert [row["status"] for row in rows] == ["broken", "disturbed", "unknown"]
    assert rows[0]["effects"] and not rows[2]["effects"] and rows[2]["reason"] == "the file has no diagnostics"

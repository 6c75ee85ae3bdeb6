"""The faults out of the catalogue of sets with a wide background: what each does alone, and how sets draw them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.excitation.suite import READY, make_suite

from np_blind.arm.evaluation.scoring import modules
from np_blind.arm.loop import make_targets, run
from np_blind.arm.plant.blind_arm import PERIOD, BatchedArms
from np_blind.arm.plant.physics import nominal_physics
from np_blind.arm.plant.rigid_arm import JOINTS
from np_blind.arm.plant.unknown_fault_physics import UnknownFaultPhysics
from np_blind.arm.plant.unknown_fault_physics_wide import ONSET, POWER, SHALLOW, measured_speed
from np_blind.arm.sampling.cases import ArmCase, draw_cases, make_physics
from np_blind.arm.sampling.faults import Fault
from np_blind.arm.sampling.unknown_fault_kinds_wide import WIDE
from np_blind.arm.sampling.unknown_faults import BEFORE, OLD_BETWEEN, UNKNOWN_FAULTS, draw_unknown_faults
from np_control.safety import LIMITS
from np_description.panda import NOMINAL

STEP = 5e-4
STILL = np.zeros((1, JOINTS))
speeds = st.lists(st.floats(-3, 3), min_size=5, max_size=80)
EVERYWHERE = [Fault(name, joint, 10.0) for name, (_, joints) in WIDE.items() for joint in joints]


def one_arm(**values):
    """The faults of an arm whose joint 4 has `values`."""
    physics = nominal_physics(1)
    for name, value in values.items():
        getattr(physics, name)[0, 3] = value
    return UnknownFaultPhysics(physics, set(values), [np.random.default_rng(0)], READY[None], PERIOD, STEP)


def asked(torque):
    return torque * np.eye(JOINTS)[None, 3]


def given_torques(faulty, torques):
    """What the drive of joint 4 gives, one step after the other; the other joints give their command: nothing."""
    found = np.array([faulty.given(asked(torque), STILL)[0] for torque in torques])
    assert not np.delete(found, 3, axis=1).any()
    return found[:, 3]


def test_wide_sets_draw_every_new_kind_before_an_old_one_and_few_of_those():
    def drawn(seed, count):
        dealt = draw_unknown_faults(np.random.default_rng(seed))
        return [next(dealt) for _ in range(count)]

    names = drawn(600, 2 * (len(WIDE) + OLD_BETWEEN))
    assert len(WIDE) >= 8 and not set(WIDE) & (set(BEFORE) | set(modules()))
    assert set(names[: len(WIDE)]) == set(WIDE)
    assert len(set(names[len(WIDE) : len(WIDE) + OLD_BETWEEN]) & set(BEFORE)) == OLD_BETWEEN < len(WIDE)
    assert set(names[len(WIDE) + OLD_BETWEEN :][: len(WIDE)]) == set(WIDE)
    strangers = [c.faults[0] for c in draw_cases(200, 600, "development") if c.kind == "stranger"]
    assert {f.effect for f in strangers} >= set(WIDE) and min(f.size for f in strangers) >= 3.0


def test_a_new_kind_of_no_size_leaves_the_arm_as_it_is():
    clean, _ = make_physics([ArmCase(0, "null", (), (1, 600, 2, 0))])
    faults = [Fault(name, joints[0], 0.0) for name, (_, joints) in WIDE.items()]
    physics, _ = make_physics([ArmCase(i, "stranger", (f,), (1, 600, 2, 0)) for i, f in enumerate(faults)])
    arms = [physics.take([i]) for i in range(len(faults))]
    ends = []
    for arm in [clean, *arms]:
        plant = BatchedArms(arm, READY, [np.random.default_rng(0)])
        for k in range(50):
            plant.begin(plant.q, plant.dq)
            plant.step(np.full((1, JOINTS), 0.8 * np.sin(0.3 * k)))
        ends.append(np.concatenate([plant.q[0], plant.torque[0], measured_speed(arm, plant.dq)[0]]))
    assert np.allclose(ends[1:], ends[0], atol=1e-12)


def test_every_new_kind_changes_what_is_recorded():
    own = (1, 600, 2, 0)  # the same background for all
    faults = [Fault(name, joints[-1], 5.0) for name, (_, joints) in WIDE.items()]
    cases = [ArmCase(0, "null", (), own)] + [ArmCase(i, "stranger", (f,), own) for i, f in enumerate(faults, 1)]
    record = run(make_physics(cases)[0], make_targets(make_suite(["reference"])).until(4.0), None)
    for i, fault in enumerate(faults, 1):
        seen = [
            np.abs(getattr(record, part)[:, i] - getattr(record, part)[:, 0]).max(axis=0) / unit
            for part, unit in (("position", 1e-4), ("velocity", 5e-3), ("effort", 0.1))
        ]
        assert np.max(seen, axis=0)[fault.joint] > 1.0, fault


@pytest.mark.slow
def test_new_kinds_at_their_largest_leave_the_loop_stable_at_every_joint():
    cases = [ArmCase(i, "stranger", (fault,), (1, 600, 2, 0)) for i, fault in enumerate(EVERYWHERE)]
    record = run(make_physics(cases)[0], make_targets(make_suite(["triangle_fast", "third_dwell"])), None)
    error = np.abs(record.position - record.target)
    assert (error.max(axis=(0, 2)) < 0.3).all() and (error[-1].max(axis=1) < 0.5 * LIMITS.start_tolerance).all()


def test_a_cable_snaps_over_late_either_way_and_takes_work():
    faulty = one_arm(snap=0.3, snap_angle=READY[3] + 0.01, snap_width=0.04)
    path = READY[3] + 0.2 * np.sin(np.linspace(0, 4 * np.pi, 8001))
    q = np.tile(READY, (len(path), 1))
    q[:, 3] = path
    torque = np.array([faulty.link_torque(row[None], STILL, 0.0)[0] for row in q])
    assert not np.delete(torque, 3, axis=1).any() and set(np.round(torque[:, 3], 12)) == {-0.3, 0.3}
    turns = path[1:][np.diff(torque[:, 3]) != 0] - READY[3]
    assert np.abs(turns) == pytest.approx([0.05, 0.03, 0.05, 0.03], abs=1e-3)
    late = slice(2000, 6001)  # a whole round
    assert np.trapezoid(torque[late, 3], path[late]) == pytest.approx(2 * 0.3 * 2 * 0.04, rel=0.02)


def test_a_lopsided_drive_gives_more_one_way_and_a_coarse_converter_gives_steps():
    assert given_torques(one_arm(lopsided=0.1), [-2.0, 0.0, 2.0]) == pytest.approx([-1.8, 0.0, 2.2])
    found = given_torques(one_arm(converter_step=0.2), [-0.31, -0.09, 0.0, 0.11, 0.51])
    assert found == pytest.approx([-0.4, 0.0, 0.0, 0.2, 0.6])


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-5, 5), min_size=2, max_size=60))
def test_torque_with_hysteresis_is_never_further_behind_than_its_play(torques):
    found = given_torques(one_arm(drive_play=0.2), torques)
    assert np.abs(found - torques).max() <= 0.2 + 1e-12
    moved = np.abs(np.diff(found)) > 0
    assert np.abs(found - torques)[1:][moved] == pytest.approx(0.2)


def test_a_notch_takes_away_its_band_and_nothing_else():
    depth, frequency = 0.6, 3.0
    for asked_frequency, left in ((0.0, 1.0), (0.5, 1.0), (frequency, 1.0 - depth), (100.0, 1.0)):
        time = STEP * np.arange(8000)
        torque = np.cos(2 * np.pi * asked_frequency * time)
        found = given_torques(one_arm(notch=depth, notch_frequency=frequency), torque)
        assert np.abs(found[4000:]).max() == pytest.approx(left, abs=0.03)
    w = 2 * np.pi * 2.0 / (2 * np.pi * frequency)
    time = STEP * np.arange(10_000)
    found = given_torques(one_arm(notch=depth, notch_frequency=frequency), np.cos(2 * np.pi * 2.0 * time))[4000:]
    response = 1.0 - depth * 2j * SHALLOW * w / (1.0 - w**2 + 2j * SHALLOW * w)
    assert np.abs(found).max() == pytest.approx(abs(response), abs=0.02)


def test_gauges_that_creep_give_too_much_of_a_change_for_a_while():
    found = given_torques(one_arm(creep=0.2, creep_time=0.3), [1.0] * 10 + [2.0] * 4000)
    assert found[:10] == pytest.approx(np.ones(10))
    assert found[10] == pytest.approx(2.2, abs=0.01) and found[-1] == pytest.approx(2.0, abs=1e-3)
    assert found[10 + 600] == pytest.approx(2.0 + 0.2 / np.e, abs=0.01)


def test_a_supply_sags_with_the_power_of_the_whole_arm_but_not_with_what_is_given_back():
    faulty, speed = one_arm(sag=0.1, sag_time=0.05), np.zeros((1, JOINTS))
    speed[0, 1] = 1.0
    wanted = np.zeros((1, JOINTS))
    wanted[0, 1], wanted[0, 3] = POWER, 4.0
    for _ in range(2000):
        found = faulty.given(wanted, speed)
    assert found[0, 3] == pytest.approx(4.0 * 0.9, rel=1e-3) and found[0, 1] == POWER
    for _ in range(2000):
        found = faulty.given(wanted, -speed)
    assert found == pytest.approx(wanted)


def test_what_a_neighbour_is_asked_for_is_given_here_too():
    physics = nominal_physics(1)
    physics.crosstalk[0, 3, 4] = -0.1
    faulty = UnknownFaultPhysics(physics, {"crosstalk"}, [np.random.default_rng(0)], READY[None], PERIOD, STEP)
    wanted = np.arange(7.0)[None]
    assert faulty.given(wanted, STILL) - wanted == pytest.approx(asked(-0.4))


def test_a_seal_rubs_after_a_reversal_only_and_a_cover_only_when_fast():
    faulty = one_arm(seal=0.3, seal_stroke=0.05)
    forward, backward = 0.5 * np.ones((1, JOINTS)), -0.5 * np.ones((1, JOINTS))
    level = np.array([faulty.friction(READY[None], v)[0] for v in [forward] * 400 + [backward] * 600])
    assert not np.delete(level, 3, axis=1).any()
    assert (level >= 0).all() and level.max() == pytest.approx(0.3, abs=1e-3)
    assert level[399, 3] == pytest.approx(0.0) and level[400 + 200, 3] == pytest.approx(0.3, abs=1e-3)
    assert level[-1, 3] == pytest.approx(0.0)
    faulty = one_arm(cover=0.4, cover_speed=0.3)
    for speed, touching in ((0.29, 0.0), (-0.29, 0.0), (0.3 + ONSET, 0.4), (-1.0, 0.4)):
        assert faulty.friction(READY[None], speed * np.ones((1, JOINTS)))[0, 3] == pytest.approx(touching)


@settings(deadline=None, max_examples=20)
@given(speeds)
def test_a_snapping_cable_gives_back_no_more_than_it_holds(path):
    faulty, q, work = one_arm(snap=0.3, snap_angle=READY[3], snap_width=0.03), READY[None].copy(), 0.0
    for speed in np.repeat(path, 20):
        q = q + STEP * speed * np.eye(JOINTS)[None, 3]
        torque = faulty.link_torque(q, STILL, 0.0)[0, 3]
        work += torque * speed * STEP
    held = torque * (q - READY)[0, 3]  # nothing when it began, at the angle itself
    assert work >= held - 0.3 * STEP * len(path) * 3


def test_rotors_that_share_a_gear_are_a_body_still_and_speed_is_shown_wrong_where_it_is():
    for joint in WIDE["coupled_rotors"][1]:
        physics, _ = make_physics([ArmCase(0, "stranger", (Fault("coupled_rotors", joint, 10.0),), (1, 600, 2, 0))])
        rotor = np.diag(NOMINAL.armature) + physics.rotor_coupling[0]
        assert np.linalg.eigvalsh(rotor).min() > 0 and np.array_equal(rotor, rotor.T)
        assert np.count_nonzero(physics.rotor_coupling) == 2
    physics = nominal_physics(1)
    physics.tachometer[0, 3] = 0.05
    assert measured_speed(physics, np.ones((1, JOINTS)))[0] == pytest.approx(1.0 + 0.05 * np.eye(JOINTS)[3])


def test_every_kind_is_given_where_it_says():
    for name, (_, joints) in UNKNOWN_FAULTS.items():
        assert set(joints) <= set(range(JOINTS)), name
    assert {joint for name in WIDE for joint in WIDE[name][1]} == set(range(JOINTS))

"""What the faults out of the catalogue do, each alone: they keep to physics too."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.excitation.suite import READY

from np_blind.arm.plant.blind_arm import PERIOD
from np_blind.arm.plant.physics import nominal_physics
from np_blind.arm.plant.unknown_fault_physics import UnknownFaultPhysics, eccentric_encoder_error, encoder_slip

paths = st.lists(st.floats(-3, 3), min_size=5, max_size=80)


def one_arm(**values):
    """One arm with faults out of the catalogue: joint 4 has `values`; its physics."""
    physics = nominal_physics(1)
    for name, value in values.items():
        getattr(physics, name)[0, 3] = value
    return UnknownFaultPhysics(physics, set(values), [np.random.default_rng(0)], READY[None], PERIOD, 5e-4), physics


def test_a_dent_holds_on_both_sides_and_takes_no_work():
    faulty, _ = one_arm(dent=0.4, dent_angle=READY[3], dent_width=0.03)
    q = np.tile(READY, (4001, 1))
    q[:, 3] += np.linspace(-0.2, 0.2, 4001)
    torque = faulty.link_torque(q, np.zeros_like(q), 0.0)[:, 3]
    assert np.abs(torque).max() == pytest.approx(0.4, rel=1e-3)
    assert (torque[:1900] < 0).all() and (torque[2100:] > 0).all()  # what resists: back to the middle
    assert np.trapezoid(torque, q[:, 3]) == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(paths, st.floats(1.5, 5.0), st.floats(0.05, 0.15))
def test_a_loose_part_never_gives_more_than_it_took(speeds, frequency, damping):
    faulty, _ = one_arm(part_inertia=0.2, part_frequency=frequency, part_damping=damping)
    q, work = READY[None].copy(), 0.0
    for speed in np.repeat(speeds, 20):
        dq = speed * np.eye(7)[None, 3]
        work += faulty.link_torque(q, dq, 0.0)[0, 3] * speed * 5e-4
        q = q + 5e-4 * dq
    assert work >= -0.02 * 0.2 * max(np.abs(speeds)) ** 2  # of a step's discretisation


def test_a_taut_cable_pulls_on_one_side_only_and_an_amplifier_swallows_what_is_small():
    faulty, _ = one_arm(taut=4.0, taut_side=-1.0, taut_angle=READY[3] - 0.1)
    q = READY + np.eye(7)[3] * np.array([[0.3], [-0.1], [-0.3]])
    assert faulty.link_torque(q, np.zeros_like(q), 0.0)[:, 3] == pytest.approx([0.0, 0.0, -0.8])
    faulty, _ = one_arm(dead_zone=0.3)
    wanted = np.eye(7)[3] * np.array([[-1.0], [-0.2], [0.3], [0.5]])
    assert faulty.given(wanted, np.zeros_like(wanted))[:, 3] == pytest.approx([-0.7, 0.0, 0.0, 0.2])


def test_a_brake_drags_half_of_the_time_and_a_fading_drive_gives_less_and_less():
    faulty, _ = one_arm(brake=0.5)
    seen = []
    for _ in range(150_000):
        faulty.begin_period()
        seen.append(faulty.friction(READY[None], np.zeros((1, 7)))[0, 3])
    assert set(seen) == {0.0, 0.5} and 0.2 < np.mean(seen) / 0.5 < 0.8
    assert 10 < np.count_nonzero(np.diff(seen)) < 120  # 50 in 300 s
    faulty, _ = one_arm(fading=0.2, fading_time=50.0)
    scale = [faulty.drive_scale(np.ones((1, 7)), time, READY[None])[0, 3] for time in (0.0, 50.0, 1e4)]
    assert scale == pytest.approx([1.0, 1.0 - 0.2 * (1.0 - np.exp(-1.0)), 0.8])


def test_the_newest_kinds_do_what_they_say():
    faulty, physics = one_arm(commutation=0.1, commutation_order=10.0, commutation_phase=0.3)
    theta = READY + np.eye(7)[3] * np.array([[0.0], [0.1 * np.pi], [0.2 * np.pi]])
    scale = faulty.drive_scale(np.ones((3, 7)), 0.0, theta)
    assert scale[0] + scale[1] == pytest.approx(np.full(7, 2.0)) and scale[2] == pytest.approx(scale[0])
    assert scale[0, 3] != 1.0 and scale[0, 4] == 1.0
    faulty, physics = one_arm(slip=2e-3, slip_time=6.0)
    assert [encoder_slip(physics, time)[0, 3] for time in (0.0, 5.99, 6.0, 60.0)] == [0.0, 0.0, 2e-3, 2e-3]
    still, moving = np.zeros((1, 7)), np.tile(0.2, (1, 7))
    faulty, _ = one_arm(wander=0.5, wander_time=80.0)
    torque = [faulty.link_torque(READY[None], still, time)[0, 3] for time in (0.0, 20.0, 60.0)]
    assert torque == pytest.approx([0.0, 0.5, -0.5])
    faulty, _ = one_arm(grease=0.6, grease_speed=0.2)
    torque = [faulty.link_torque(READY[None], factor * moving, 0.0)[0, 3] for factor in (-1.0, 0.0, 1.0, 100.0)]
    assert torque == pytest.approx([-0.3, 0.0, 0.3, 0.6], rel=0.02)


@settings(deadline=None, max_examples=30)
@given(paths)
def test_a_dress_pack_never_gives_more_than_it_took(speeds):
    faulty, _ = one_arm(pack=0.9, pack_stroke=0.02)
    work, largest = 0.0, 0.0
    for speed in np.repeat(speeds, 20):
        torque = faulty.link_torque(READY[None], speed * np.eye(7)[None, 3], 0.0)[0, 3]
        work, largest = work + torque * speed * 5e-4, max(largest, abs(torque))
    assert work >= -1e-9 and largest <= 0.9 + 1e-12


def test_an_eccentric_disc_shows_a_speed_that_fits_its_angle():
    _, physics = one_arm(eccentric=2e-3, eccentric_phase=0.7)
    q = np.tile(READY, (2, 1)) + np.array([[-1e-4], [1e-4]])
    angle, _ = eccentric_encoder_error(physics, q)
    _, share = eccentric_encoder_error(physics, READY[None])
    assert np.diff(angle, axis=0)[0] / 2e-4 == pytest.approx(share[0], abs=1e-9)
    assert 0 < np.abs(angle[0, 3]) <= 2e-3 and not angle[:, :3].any()

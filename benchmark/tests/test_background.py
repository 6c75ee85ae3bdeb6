"""The wide background of the blind test, and the faults that go with it."""

import numpy as np
import pytest
from sim2real.excitation.suite import READY, SECOND

from np_blind.arm.evaluation.patched_arm import patched_physics
from np_blind.arm.plant.blind_arm import BatchedArms
from np_blind.arm.plant.physics import nominal_physics
from np_blind.arm.plant.rigid_arm import tcp_in_link7
from np_blind.arm.sampling.background import MASS_ERROR
from np_blind.arm.sampling.cases import ArmCase, make_physics
from np_blind.arm.sampling.faults import HAND, Fault
from np_blind.arm.sampling.measured_friction import apply_measured_friction
from np_description.panda import NOMINAL


def clean(count, seed=600):
    return [ArmCase(i, "null", (), (1, seed, 2, i)) for i in range(count)]


def settled(physics, start=READY, command=0.0, periods=200):
    """(arms after so long under a command, torques that their drives gave last, gravity compensation included)."""
    plant = BatchedArms(physics, start, [np.random.default_rng(i) for i in range(len(physics))])
    for _ in range(periods):
        plant.begin(plant.q, plant.dq)
        plant.step(np.broadcast_to(command, plant.q.shape))
    return plant, plant.torque + plant.held


def test_links_are_off_by_some_per_cent_and_the_arm_is_compensated_as_it_is():
    physics, nominal = make_physics(clean(40))[0], nominal_physics(1)
    off = physics.inertials.mass / nominal.inertials.mass - 1
    assert off.std() == pytest.approx(MASS_ERROR, rel=0.15) and np.abs(off).max() < 5 * MASS_ERROR
    away = np.linalg.norm(physics.inertials.com - nominal.inertials.com, axis=2)
    assert 0.5 * MASS_ERROR < (away / np.linalg.norm(nominal.inertials.com, axis=2)).mean() < 3 * MASS_ERROR
    physics.drive_noise[:] = 0.0
    plant, _ = settled(physics, SECOND)
    assert np.abs(plant.q - SECOND).max() < 5e-4  # its weight pulls it nowhere
    physics.compensated = nominal_physics(len(physics)).inertials
    assert np.abs(settled(physics, SECOND)[0].q - SECOND).max() > 5e-3


def test_friction_goes_up_and_down_with_the_angle_and_holds_at_standstill():
    def friction(speed, **changes):
        physics = nominal_physics(1)
        for name, value in changes.items():
            getattr(physics, name)[:] = value
        plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
        plant.omega = np.full((1, 7), speed)
        for _ in range(2000):
            found = plant._resisting(np.zeros((1, 7)))
        return found[0] - NOMINAL.damping * speed

    plain = friction(0.01)
    wave = friction(0.01, uneven=0.1, uneven_order=2.0, uneven_phase=0.5)
    assert np.allclose(wave / plain, 1 + 0.1 * np.sin(2 * READY + 0.5), atol=1e-6)
    held = friction(0.0005, holding=0.1) / friction(0.0005)
    assert np.all(held > 1.09) and np.allclose(friction(0.05, holding=0.1), friction(0.05), atol=1e-6)


def test_limits_are_of_all_that_a_drive_gives():
    physics, (truth,) = make_physics([ArmCase(0, "single", (Fault("torque_saturation", 3, 4.0),), (1, 600, 2, 0))])
    limit = truth[0]["limit"][0]
    physics.drive_noise[:] = 0.0
    physics.command_delay[:] = 0.0
    plant, whole = settled(physics, command=np.array([0, 0, 0, 9.0, 0, 0, 0]), periods=3)
    assert whole[0, 3] == pytest.approx(limit, abs=1e-6) and plant.torque[0, 3] < 9.0
    entry = {"effect": "torque_saturation", "component": "panda_joint4", "parameters": {"limit": limit}}
    assert patched_physics([[entry]]).with_weight[0, 3] == 1.0
    entry["parameters"]["gravity_apart"] = 1.0
    assert patched_physics([[entry]]).with_weight[0, 3] == 0.0


def test_a_payload_is_anywhere_on_the_hand_and_inertia_has_axes_of_its_own():
    faults = Fault("payload", None, 5.0), Fault("link_inertia", 4, 3.0)
    cases = [ArmCase(i, "single", (f,), (1, 600, 2, 0)) for i, f in enumerate(faults)]
    (loaded, turned), (mass, scale) = (make_physics(cases)[0].take([i]) for i in (0, 1)), make_physics(cases)[1]
    bare = make_physics(clean(1))[0]
    assert loaded.inertials.mass[0, 6] - bare.inertials.mass[0, 6] == pytest.approx(mass[0]["mass"][0])
    moment = (
        loaded.inertials.mass[0, 6] * loaded.inertials.com[0, 6] - bare.inertials.mass[0, 6] * bare.inertials.com[0, 6]
    )
    away = moment / mass[0]["mass"][0] - tcp_in_link7()
    assert (np.abs(away) <= HAND + 1e-9).all() and np.linalg.norm(away) > 0.005
    change = turned.inertials.inertia[0, 4] - bare.inertials.inertia[0, 4]
    assert np.linalg.eigvalsh(change).min() > 0
    before = bare.inertials.inertia[0, 4]
    assert np.abs(change @ before - before @ change).max() > 0.01 * np.abs(change @ before).max()  # other axes
    nominal = nominal_physics(1).inertials.inertia[0, 4]
    assert np.trace(turned.inertials.inertia[0, 4]) / np.trace(nominal) - 1 == pytest.approx(scale[0]["scale"][0])


def test_measured_friction_falls_at_the_wrist_by_a_third_to_a_half_and_is_uneven():
    physics = nominal_physics(200)
    for arm in range(200):
        apply_measured_friction(physics, arm, (5, arm))

    def dry(floor, fall, speed):
        return floor + fall / (1.0 + (speed / physics.fall_speed) ** physics.fall_steepness)

    ways = [(physics.coulomb_forward, physics.fall_forward), (physics.coulomb_backward, physics.fall_backward)]
    for floor, fall in ways:
        lost = 1.0 - dry(floor, fall, 0.15) / dry(floor, fall, 0.04)
        assert 0.3 < np.median(lost[:, 4:]) < 0.5 and lost[:, 4:].min() > 0.2 and lost[:, :4].max() < 0.2
    forward, backward = (dry(floor, fall, 0.0) for floor, fall in ways)
    assert (forward > 0).all() and np.median(abs(forward - backward) / (forward + backward)) > 0.05

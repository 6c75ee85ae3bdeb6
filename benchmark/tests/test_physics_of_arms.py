"""The blind generator's physics against Pinocchio, MuJoCo, and what physics forbids."""

import pickle

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.excitation.suite import READY, SECOND, THIRD, make_suite

from np_blind.arm.evaluation.held_out_motion import LOST, gaps, motions
from np_blind.arm.evaluation.patched_arm import patched_physics
from np_blind.arm.evaluation.scoring import modules
from np_blind.arm.loop import Diverged, make_targets, run
from np_blind.arm.plant.blind_arm import PERIOD, BatchedArms
from np_blind.arm.plant.hysteresis import bouc_wen, lugre, prandtl
from np_blind.arm.plant.physics import nominal_physics, stack
from np_blind.arm.plant.rigid_arm import RigidArms, nominal_inertials, tcp_in_link7
from np_blind.arm.sampling.cases import ArmCase, draw_cases, make_physics
from np_blind.arm.sampling.faults import EFFECTS, Fault, apply, largest, soften, visible, widen
from np_blind.arm.sampling.unknown_fault_kinds import LATER, NEWEST
from np_blind.arm.sampling.unknown_faults import UNKNOWN_FAULTS
from np_control.dynamics import Dynamics
from np_control.safety import LIMITS
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

postures = arrays(float, 7, elements=st.floats(-2.5, 2.5))
speeds = arrays(float, 7, elements=st.floats(-2, 2))


@settings(deadline=None, max_examples=50)
@given(postures, speeds)
def test_rigid_body_terms_are_pinocchios(q, dq):
    matrix, velocity, weight = RigidArms(nominal_inertials(1)).terms(q[None], dq[None])
    dynamics = Dynamics()
    assert np.allclose(matrix[0] + np.diag(NOMINAL.armature), dynamics.mass_matrix(q), atol=1e-10)
    assert np.allclose(velocity[0], dynamics.coriolis(q, dq), atol=1e-9)
    assert np.allclose(weight[0], dynamics.gravity(q), atol=1e-9)


MAGNITUDES = {name: {q.name for q in ARM_EFFECTS[name].quantities if q.is_magnitude} for name in EFFECTS}


@pytest.mark.parametrize("effect", [name for name, own in MAGNITUDES.items() if own])
def test_no_planted_magnitude_is_below_zero(effect):
    """The diagnosis cuts intervals of magnitudes there: none may lose a truth by it."""
    rng = np.random.default_rng(4)
    for joint in [j - 1 for j in visible(effect).joints] or [None]:
        for size in (0.8, 3.0, largest(effect, joint)):
            for widened in (False, True):
                physics, fault = nominal_physics(1), Fault(effect, joint, size)
                planted = apply(physics, 0, fault, rng)
                planted = widen(physics, 0, fault, planted, rng) if widened else planted
                assert all(value >= 0 for name, (value, _) in planted.items() if name in MAGNITUDES[effect])


def test_a_payload_is_a_point_mass_at_the_end_effector():
    q, dq = READY[None], np.zeros((1, 7))
    loaded = nominal_inertials(1)
    loaded.add_point(0, 6, 0.5, tcp_in_link7())
    _, _, weight = RigidArms(loaded).terms(q, dq)
    _, _, bare = RigidArms(nominal_inertials(1)).terms(q, dq)
    model = load_model(CARD)
    data = mujoco.MjData(model)
    data.qpos[:7] = READY
    mujoco.mj_forward(model, data)
    rotation, hand = data.body("panda_hand").xmat.reshape(3, 3), data.body("panda_hand").xpos
    point = hand + rotation @ NOMINAL.frames["hand_tcp"].position
    jacobian = np.empty((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, point, model.body("panda_hand").id)
    assert np.allclose((weight - bare)[0], 0.5 * 9.81 * jacobian[2, :7], atol=1e-6)


def free_arm(count=1):
    """Without friction, gravity compensation or rotors' losses."""
    physics = nominal_physics(count)
    for name in ("coulomb_forward", "coulomb_backward"):
        setattr(physics, name, np.full((count, 7), 1e-9))
    physics.viscous_forward, physics.viscous_backward = np.zeros((count, 7)), np.zeros((count, 7))
    return physics


def energy(plant, physics):
    matrix, _, _ = RigidArms(physics.inertials).terms(plant.q, plant.dq)
    matrix = matrix + np.diag(NOMINAL.armature)
    return 0.5 * np.einsum("bi,bij,bj->b", plant.dq, matrix, plant.dq)[0]


def test_a_free_arm_keeps_its_energy():
    """Gravity is compensated by the drives; nothing else gives or takes."""
    physics = free_arm()
    plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
    plant.dq[:] = plant.omega[:] = [0.3, -0.2, 0.4, 0.3, -0.5, 0.4, 0.6]
    before = energy(plant, physics)
    for _ in range(500):
        plant.begin(plant.q, plant.dq)
        plant.step(np.zeros((1, 7)))
    assert np.abs(plant.q - READY).max() > 0.2
    assert energy(plant, physics) == pytest.approx(before, rel=5e-3)


def test_it_moves_as_mujoco_does_under_the_same_torque():
    """One second of torques, twice the integrator and step of each."""
    physics = nominal_physics(1)
    plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
    model = load_model(CARD, timestep=2e-4)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("ready").id)
    motors = [model.actuator(name).id for name in NOMINAL.joints]
    for k in range(500):
        torque = 3.0 * np.sin(2 * np.pi * 1.5 * k * PERIOD) * np.array([1, 1, 1, 1, 0.3, 0.3, 0.2])
        plant.begin(plant.q, plant.dq)
        plant.step(torque[None])
        data.ctrl[motors] = torque
        mujoco.mj_step(model, data, 10)
    moved = np.abs(data.qpos[:7] - READY).max()
    assert moved > 0.03
    assert np.abs(plant.q[0] - data.qpos[:7]).max() < 0.05 * moved


paths = st.lists(st.floats(-3, 3), min_size=5, max_size=80)


@settings(deadline=None)
@given(paths, st.floats(0.05, 2), st.floats(0.05, 2), st.floats(1e2, 1e4))
def test_prandtls_element_never_gives_more_than_it_took(speeds, forward, backward, stiffness):
    bend, work, h = np.zeros(1), 0.0, 2.5e-4
    for speed in speeds:
        bend, friction = prandtl(bend, np.array([speed]), forward, backward, stiffness, h)
        assert -backward - 1e-12 <= friction[0] <= forward + 1e-12
        work += friction[0] * speed * h
        assert work >= 0.5 * stiffness * bend[0] ** 2 - 1e-9


@settings(deadline=None)
@given(paths, st.floats(0.05, 2), st.floats(1e-3, 3e-2))
def test_lugres_element_never_gives_more_than_it_took(speeds, level, stroke):
    bend, work, h = np.zeros(1), 0.0, 2.5e-4
    for speed in speeds:
        bend, friction = lugre(bend, np.array([speed]), level, stroke, h)
        assert abs(friction[0]) <= level + 1e-12
        work += friction[0] * speed * h
        assert work >= 0.5 * level / stroke * bend[0] ** 2 - 1e-9


def test_friction_reaches_its_level_and_bouc_wen_its_limit():
    bend = np.zeros(1)
    for _ in range(2000):
        bend, friction = prandtl(bend, np.array([0.2]), 0.4, 0.3, 4e3, 2.5e-4)
    assert friction[0] == pytest.approx(0.4)
    for _ in range(2000):
        bend, friction = prandtl(bend, np.array([-0.2]), 0.4, 0.3, 4e3, 2.5e-4)
    assert friction[0] == pytest.approx(-0.3)
    assert bouc_wen(np.zeros(1), np.array([1.0]), np.array([1e-3]), 1.0)[0] == pytest.approx(1e-3)


def test_a_joint_sticks_below_breakaway_and_slides_above():
    for torque, slides in ((0.8, False), (1.2, True)):
        plant = BatchedArms(nominal_physics(1), READY, [np.random.default_rng(0)])
        for _ in range(300):
            plant.begin(plant.q, plant.dq)
            plant.step(torque * NOMINAL.frictionloss[None] * (np.arange(7) == 3))
        assert (np.abs(plant.q - READY)[0, 3] > 5e-3) == slides


@pytest.mark.parametrize("delay", [0.0, 3e-4, 0.001, 0.0027, 0.006])
def test_a_delayed_command_gives_the_same_impulse_later(delay):
    physics = free_arm()
    physics.command_delay[:] = delay
    plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
    impulse = moment = 0.0
    for k in range(8):
        plant.begin(plant.q, plant.dq)
        plant.step((k == 1) * np.eye(7)[None, 6])
        impulse += plant.torque[0, 6] * PERIOD
        moment += plant.torque[0, 6] * PERIOD * (k + 0.5) * PERIOD
    assert impulse == pytest.approx(PERIOD, rel=1e-9)
    assert moment / impulse == pytest.approx(1.5 * PERIOD + delay, rel=1e-9)


def short_run(cases, names=("sinusoid_4",), seeds=True, background=True, until=np.inf):
    physics, truths = make_physics(cases, background)
    targets = make_targets(make_suite(list(names))).until(until)
    return run(physics, targets, [c.seed for c in cases] if seeds else None), targets, truths


def all_faults(size):
    def joint(effect):
        # No set has a drive cut that is needed to hold the arm up.
        places = [place for place in visible(effect).joints if largest(effect, place - 1) >= 1.0]
        return None if not places else (4 if 4 in places else places[0]) - 1

    faults = [Fault(e, joint(e), min(size, largest(e, joint(e)))) for e in EFFECTS]
    faults += [Fault(s, 3 if 3 in places else places[0], size) for s, (_, places) in UNKNOWN_FAULTS.items()]
    cases = [ArmCase(0, "null", (), (5, 5))]
    return cases + [
        ArmCase(i + 1, "single" if f.effect in EFFECTS else "stranger", (f,), (5, 5)) for i, f in enumerate(faults)
    ]


@pytest.mark.slow
def test_every_fault_moves_the_arm_or_its_sensors_and_none_breaks_the_loop():
    cases = all_faults(8.0)
    record, targets, _ = short_run(cases, ("third_dwell",))
    for i, case in enumerate(cases[1:], start=1):
        name = case.faults[0].effect
        error = np.abs(record.position[:, i] - record.target[:, i])
        # A drive that saturates falls behind; at rest every arm is where the next segment may begin.
        assert error.max() < 0.3 and error[-1].max() < 0.5 * LIMITS.start_tolerance, name
        seen = sum(
            np.abs(getattr(record, part)[:, i] - getattr(record, part)[:, 0]).max() / unit
            for part, unit in (("position", 1e-5), ("effort", 1e-2), ("motor_position", 1e-5))
        )
        assert seen > 1.0, name


@pytest.mark.slow
def test_later_kinds_out_of_the_catalogue_at_their_largest_leave_the_loop_stable_at_every_joint():
    faults = [Fault(name, joint, 10.0) for name, (_, joints) in (LATER | NEWEST).items() for joint in joints]
    cases = [ArmCase(i, "stranger", (fault,), (5, i)) for i, fault in enumerate(faults)]
    record, _, _ = short_run(cases, ("triangle_fast", "third_dwell"))
    error = np.abs(record.position - record.target)
    assert (error.max(axis=(0, 2)) < 0.3).all() and (error[-1].max(axis=1) < 0.5 * LIMITS.start_tolerance).all()


def test_an_offset_pushes_the_way_that_patch_and_sim_bridge_say():
    physics, ((truth,),) = make_physics([ArmCase(0, "single", (Fault("torque_offset", 3, 12.0),), (5, 5))], False)
    offset = truth["offset"][0]
    plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
    for _ in range(100):
        plant.begin(plant.q, plant.dq)
        plant.step(np.zeros((1, 7)))
    bridge = ArmEffects(Patch((PatchEffect("torque_offset", NOMINAL.joints[3], {"offset": offset}),)), PERIOD)
    assert bridge.drive(np.zeros(7), READY)[3] == offset
    assert np.sign((plant.q - READY)[0, 3]) == np.sign(offset)
    entry = {"effect": "torque_offset", "component": NOMINAL.joints[3], "parameters": {"offset": offset}}
    assert np.array_equal(patched_physics([[entry]]).offset, physics.offset)


SOFT = ("backlash", "transmission_hysteresis", "joint_elasticity")


@pytest.mark.parametrize("posture", [READY, SECOND, THIRD], ids=["ready", "second", "third"])
def test_a_gear_at_any_joint_is_stable_in_every_posture(posture):
    """The link of the wrist alone is 5e-3 kg m^2: on a gear of 1e5 Nm/rad it swings at 700 Hz."""
    cases = [
        ArmCase(0, "single", (Fault(effect, joint, visible(effect).largest),), (5, 5))
        for effect in SOFT
        for joint in range(7)
    ]
    physics, _ = make_physics(cases)
    plant = BatchedArms(physics, posture, [np.random.default_rng(0) for _ in cases])
    plant.dq[:] = plant.omega[:] = 0.3
    fastest = 0.0
    for _ in range(150):
        plant.begin(plant.q, plant.dq)
        plant.step(-60.0 * (plant.q - posture) - 6.0 * plant.dq)
        fastest = max(fastest, float(np.abs(plant.dq).max()))
    assert fastest < 3.0
    assert np.abs(plant.dq).max() < 0.3 and np.abs(plant.theta - plant.q).max() < 2e-2


def test_a_twisted_gear_holds_the_torque_that_twists_it():
    stiffness = 5e3
    physics = nominal_physics(1)
    soften(physics, 0, 6, stiffness)
    # A spring pulls on the link, friction holds the rotor.
    physics.cable_stiffness[0, 6], physics.cable_centre[0, 6] = 50.0, READY[6] + 0.05
    plant = BatchedArms(physics, READY, [np.random.default_rng(0)])
    for _ in range(1000):
        plant.begin(plant.q, plant.dq)
        plant.step(np.zeros((1, 7)))
    wound = stiffness * (plant.q - plant.theta)[0, 6]
    assert np.abs(plant.dq[0, 6]) < 1e-4 and wound > 0.02
    assert wound == pytest.approx(50.0 * (physics.cable_centre - plant.q)[0, 6], rel=0.01)


def test_an_arm_that_runs_away_is_named_and_leaves_the_others():
    cases = draw_cases(3, 0, "development")
    physics, _ = make_physics(cases)
    physics.viscous_forward[1] = physics.viscous_backward[1] = -40.0
    targets = make_targets(make_suite(["sinusoid_7"])).until(2.5)
    with pytest.raises(Diverged) as caught:
        run(physics, targets, [c.seed for c in cases])
    error = pickle.loads(pickle.dumps(caught.value))
    assert error.arms == (1,) and "arms (1,)" in str(error)
    alone = run(physics.take([0, 2]), targets, None).position
    moved = motions(physics, targets)
    assert np.allclose(moved[:, [0, 2]], alone[targets.first :], atol=1e-9)
    assert gaps(moved, targets.position[targets.first :, None])[1] == pytest.approx(LOST)


def test_arms_do_not_depend_on_their_batch():
    cases = draw_cases(6, 3, "development")
    together, _, _ = short_run(cases, ("sinusoid_7",), until=2.5)
    alone, _, _ = short_run(cases[2:3], ("sinusoid_7",), until=2.5)
    assert np.allclose(together.position[:, 2], alone.position[:, 0], atol=1e-9)
    assert np.allclose(together.effort[:, 2], alone.effort[:, 0], atol=1e-6)


def test_the_nominal_arm_follows_and_shows_the_torque_that_was_asked_for():
    cases = [ArmCase(0, "null", (), (7, 7))]
    record, targets, _ = short_run(cases, seeds=False, background=False)
    error = record.position[targets.first :, 0] - record.target[targets.first :, 0]
    assert np.abs(error).max() < 5e-3
    assert np.allclose(record.effort[1:], record.command[:-1], atol=1e-9)
    assert np.array_equal(record.applied, record.command)


def test_arms_can_be_stacked():
    one, other = make_physics(draw_cases(2, 0, "development"))[0], nominal_physics(3)
    both = stack([one, other])
    assert len(both) == 5 and np.array_equal(both.inertials.mass[2:], other.inertials.mass)
    assert np.array_equal(both.stiffness_factor[:2], one.stiffness_factor)


def test_cases_are_balanced_and_sets_lie_apart():
    cases = draw_cases(200, 0, "locked")
    kinds = [case.kind for case in cases]
    assert {k: kinds.count(k) for k in set(kinds)} == {"null": 30, "single": 100, "pair": 35, "stranger": 35}
    singles = [case.faults[0].effect for case in cases if case.kind == "single"]
    assert set(singles) == set(EFFECTS) and max(map(singles.count, EFFECTS)) <= 4
    assert all(0.8 <= f.size <= 10.0 for case in cases for f in case.faults)
    assert draw_cases(200, 0, "locked") == cases
    other = draw_cases(200, 0, "development")
    assert not {case.seed for case in cases} & {case.seed for case in other}
    assert [c.faults for c in cases] != [c.faults for c in other]


def test_every_arm_side_effect_of_the_catalogue_has_a_generator_and_a_limit():
    beside = {"contact", "object", "environment", "camera", "keypoints"}
    of_policies = {"policy_latency", "policy_jitter"}  # of the module timing, but no arm has them
    drawn_otherwise = {"friction_curve"}  # by a law of its own (measured_friction)
    assert (
        set(EFFECTS) == {e for e, module in modules().items() if module not in beside} - of_policies - drawn_otherwise
    )
    assert all(visible(effect) for effect in EFFECTS) and not set(UNKNOWN_FAULTS) & set(modules())

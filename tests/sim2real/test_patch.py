"""Patches: files that are refused with their reason, and what they make of the arm."""

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.effect import EffectTarget
from sim2real.effects.patch import Patch, PatchEffect, dump_patch, load_patch

from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

joints = st.sampled_from(NOMINAL.joints)


@st.composite
def effects(draw):
    record = ARM_EFFECTS[draw(st.sampled_from(sorted(ARM_EFFECTS)))]
    values = {q.name: draw(st.floats(q.lower, q.upper)) for q in record.quantities if draw(st.booleans())}
    arm = st.just("arm")
    places = {EffectTarget.LINK: joints, EffectTarget.ARM: arm, EffectTarget.JOINT: joints | arm}
    return PatchEffect(record.id, draw(places[record.target]), values)


@settings(deadline=None, max_examples=60)
@given(st.lists(effects(), max_size=5))
def test_what_is_written_is_read(tmp_path_factory, found):
    path = tmp_path_factory.mktemp("patch") / "patch.yaml"
    path.write_text(dump_patch(Patch(tuple(found))))
    assert load_patch(path) == Patch(tuple(found))


def test_what_is_less_than_physical_is_told_by_effect_joint_and_what_is_in_force():
    patch = Patch(
        (
            PatchEffect("coulomb_friction", "panda_joint2", {"level": -5.0}),
            PatchEffect("coulomb_friction", "panda_joint3", {"level": 0.1}),
            PatchEffect("armature", "panda_joint3", {"change": 0.1}),
        )
    )
    wanted = NOMINAL.frictionloss[1] - 5.0
    told = f"coulomb_friction at panda_joint2: asks for a frictionloss of {wanted:.4g} Nm, in force is 0"
    assert patch.list_clipped_parameters() == [told] and patch.panda().frictionloss[1] == 0.0
    assert Patch(patch.effects[1:]).list_clipped_parameters() == []


ENTRY = {"effect": "coulomb_friction", "component": "panda_joint1", "parameters": {"level": 0.1}}


@pytest.mark.parametrize(
    "content, text",
    [
        ("effects: 3", "expected a mapping with the list 'effects'"),
        ("- 1", "expected a mapping with the list 'effects'"),
        ("effects: [", "expected a patch.yaml, got"),
        ([{**ENTRY, "effect": "magic"}], "entry 0: expected an effect of the arm"),
        (
            [ENTRY, {**ENTRY, "component": "elbow"}],
            "entry 1: expected 'arm' or a joint as component, got 'elbow'",
        ),
        ([{**ENTRY, "parameters": {"size": 1.0}}], "expected finite numbers for level; got size"),
        (
            [{**ENTRY, "parameters": {"level": float("nan")}}],
            "expected finite numbers for level; got level: nan",
        ),
        ([{**ENTRY, "parameters": {"level": "much"}}], "got level: 'much'"),
        (
            [{**ENTRY, "parameters": {"level": 400.0}}],
            "expected level of coulomb_friction from -20 to 20 Nm, got 400.0",
        ),
        (
            [{"effect": "link_com", "component": "arm", "parameters": {}}],
            "expected the joint that moves the link as component of link_com, got 'arm'",
        ),
        (
            [{"effect": "payload", "component": "panda_joint4", "parameters": {"mass": 0.2}}],
            "expected 'arm' as component of payload, got 'panda_joint4'",
        ),
        ([{"effect": "payload"}], "entry 0: expected effect, component and parameters"),
    ],
)
def test_a_file_that_is_wrong_says_where(tmp_path, content, text):
    path = tmp_path / "patch.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump({"effects": content}))
    with pytest.raises(ValueError, match=text):
        load_patch(path)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match="missing.yaml: expected a patch.yaml, got"):
        load_patch(tmp_path / "missing.yaml")


def one(effect, component="panda_joint3", **parameters):
    return Patch((PatchEffect(effect, component, parameters),))


@given(st.floats(-0.1, 2.0), joints)
def test_friction_damping_and_rotors_are_added_in_their_joint(change, joint):
    for effect, parameter, field in (
        ("coulomb_friction", "level", "frictionloss"),
        ("viscous_friction", "coefficient", "damping"),
        ("armature", "inertia", "armature"),
    ):
        arm = one(effect, joint, **{parameter: change}).panda()
        added = getattr(arm, field) - getattr(NOMINAL, field)
        least = -getattr(NOMINAL, field)[NOMINAL.joints.index(joint)]  # there is no less than none
        assert added[NOMINAL.joints.index(joint)] == pytest.approx(max(change, least), abs=2e-3)
        assert (np.delete(added, NOMINAL.joints.index(joint)) == 0).all()


@given(st.floats(-0.1, 1.0), st.floats(-0.1, 1.0))
def test_the_mean_of_an_asymmetry_is_the_models_the_rest_is_not(positive, negative):
    arm = one("asymmetric_coulomb_friction", level_positive=positive, level_negative=negative).panda()
    assert arm.frictionloss[2] == pytest.approx(max(NOMINAL.frictionloss[2] + (positive + negative) / 2, 0.0))


def test_effects_of_one_joint_add_up_and_what_sits_at_the_arm_is_everywhere():
    patch = Patch(
        (
            *one("coulomb_friction", level=0.1).effects,
            *one("coulomb_friction", level=0.2).effects,
            *one("command_delay", "arm", delay=0.003).effects,
        )
    )
    assert np.allclose(patch.per_joint("coulomb_friction", "level"), 0.3 * (np.arange(7) == 2))
    assert np.allclose(patch.per_joint("command_delay", "delay"), 0.003)
    assert len(patch.of("coulomb_friction")) == 2 and patch.per_joint("payload", "mass").sum() == 0


def energy_and_weight(panda):
    """Kinetic energy of a motion and the torque that holds, with a model made of this arm."""
    model = load_model(CARD, panda=panda)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[:7] = np.linspace(0.3, -0.5, 7)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    held = np.empty(model.nv)
    data.qvel[:] = 0
    mujoco.mj_forward(model, data)
    mujoco.mj_rne(model, data, 0, held)
    velocity = np.linspace(0.3, -0.5, 7)
    return 0.5 * velocity @ mass[:7, :7] @ velocity, held[:7], data, model


@settings(deadline=None, max_examples=10)
@given(st.floats(0.05, 2.0))
def test_a_payload_is_a_point_mass_at_the_tool(mass):
    energy, weight, data, model = energy_and_weight(NOMINAL)
    heavier, loaded, _, _ = energy_and_weight(one("payload", "arm", mass=mass).panda())
    jacobian = np.empty((3, model.nv))
    body = model.body("panda_hand").id
    point = (
        data.body("panda_hand").xpos + data.body("panda_hand").xmat.reshape(3, 3) @ NOMINAL.frames["hand_tcp"].position
    )
    mujoco.mj_jac(model, data, jacobian, None, point, body)
    speed = jacobian[:, :7] @ np.linspace(0.3, -0.5, 7)
    assert heavier - energy == pytest.approx(0.5 * mass * speed @ speed, rel=1e-6)
    assert np.allclose(loaded - weight, 9.81 * mass * jacobian[2, :7], atol=1e-6)


@settings(deadline=None, max_examples=10)
@given(st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=3), st.sampled_from(range(1, 7)))
def test_a_moment_moves_the_centre_of_mass_and_no_mass(moment, joint):
    patch = one("link_com", NOMINAL.joints[joint], **{f"moment_{a}": m for a, m in zip("xyz", moment)})
    body, nominal = (arm.inertials[f"link{joint + 1}"] for arm in (patch.panda(), NOMINAL))
    assert body.mass == nominal.mass and np.allclose(body.mass * (body.com - nominal.com), moment)


@given(st.floats(-0.5, 2.0), joints)
def test_link_inertia_is_scaled_about_the_centre_of_mass(scale, joint):
    name = f"link{NOMINAL.joints.index(joint) + 1}"
    body = one("link_inertia", joint, scale=scale).panda().inertials[name]
    assert np.allclose(body.inertia, (1 + scale) * NOMINAL.inertials[name].inertia)
    assert np.array_equal(body.com, NOMINAL.inertials[name].com)


def test_nothing_changes_nothing():
    arm = Patch().panda()
    assert all(
        np.array_equal(getattr(arm, name), getattr(NOMINAL, name)) for name in ("frictionloss", "damping", "armature")
    )
    assert all(np.array_equal(body.com, NOMINAL.inertials[name].com) for name, body in arm.inertials.items())

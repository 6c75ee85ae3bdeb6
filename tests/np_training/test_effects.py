"""Patches of the diagnosis in the batched simulator."""

import dataclasses
import json
import sys

import numpy as np
import pytest
import torch
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.effect import EffectTarget
from sim2real.effects.gravity import GravityTorque
from sim2real.effects.patch import Patch, PatchEffect, dump_patch

from np_description.camera import CAMERA
from np_description.domains import CARD, WALL
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_training import evaluate, train
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.view import BatchedView, Past
from np_training.physics.batched import ARM, HOLD_STIFFNESS, OBJECT_POSITION, BatchedPhysics
from np_training.physics.batched_effects import batched_effects
from np_training.physics.batched_gravity import BatchedHold
from np_training.physics.config import PhysicsConfig
from np_training.physics.supported_effects import SUPPORTED, check_supported, load_effects

PATCH = Patch(
    (
        PatchEffect("coulomb_friction", "panda_joint4", {"level": 0.8}),
        PatchEffect("viscous_friction", "panda_joint2", {"coefficient": 1.5}),
        PatchEffect("armature", "panda_joint6", {"inertia": 0.1}),
        PatchEffect("link_inertia", "panda_joint5", {"scale": 0.5}),
    )
)


def speeds_after(config: PhysicsConfig) -> np.ndarray:
    """Joint speeds of an arm without any command, two joints of which were moving."""
    physics = BatchedPhysics(CARD, 2, "cpu", dataclasses.replace(config, substeps=4))
    physics.command.zero_()
    physics.qvel[:, 1], physics.qvel[:, 3], physics.noise[:, 5] = 0.5, -0.5, 4.0
    physics.advance()
    return physics.qvel[0, ARM].numpy().copy()


def test_a_patch_changes_the_arm_that_is_simulated():
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(effects=PATCH))
    dofs = slice(0, 7)
    model = physics.model
    friction, damping, armature = (
        np.asarray(getattr(model, name).numpy()).reshape(-1, physics.host_model.nv)[0, dofs]
        for name in ("dof_frictionloss", "dof_damping", "dof_armature")
    )
    expected = PATCH.panda()
    for found, wanted, nominal in (
        (friction, expected.frictionloss, NOMINAL.frictionloss),
        (damping, expected.damping, NOMINAL.damping),
        (armature, expected.armature, NOMINAL.armature),
    ):
        assert np.allclose(found, wanted, rtol=1e-5) and (np.abs(wanted - nominal) > 0).sum() == 1


@pytest.mark.parametrize(
    "effect, joint, sign", [(PATCH.effects[0], 3, 1), (PATCH.effects[1], 1, -1), (PATCH.effects[2], 5, -1)]
)
def test_the_arm_moves_as_the_effect_says(effect, joint, sign):
    """Joint 4 moves backwards and is slowed, joint 2 is damped, joint 6 is heavier to accelerate."""
    nominal, patched = (speeds_after(PhysicsConfig(effects=patch)) for patch in (Patch(), Patch((effect,))))
    change = sign * (patched - nominal)[joint]
    assert change > 2e-3
    assert change > np.abs(np.delete(patched - nominal, joint)[:joint]).max()  # what follows is only carried along


def test_link_inertia_reaches_the_model():
    bodies = [
        BatchedPhysics(CARD, 1, "cpu", PhysicsConfig(effects=patch)).host_model.body("panda_link5").inertia
        for patch in (Patch(), PATCH)
    ]
    assert np.allclose(bodies[1], 1.5 * bodies[0])


def one_of(effect: str) -> PatchEffect:
    """The effect at a joint, or the arm, with each of its quantities a tenth up its range (of delays: some periods)."""
    record = ARM_EFFECTS[effect]
    component = "arm" if record.target is EffectTarget.ARM else "panda_joint4"
    return PatchEffect(effect, component, {q.name: _a_tenth(q) for q in record.quantities})


def _a_tenth(quantity) -> float:
    if quantity.name == "delay":
        return 0.0037
    if quantity.name == "gravity_apart":
        return 0.0
    return quantity.lower + 0.55 * (quantity.upper - quantity.lower) if quantity.lower < 0 else 0.1 * quantity.upper


@pytest.mark.parametrize("effect", [name for name in SUPPORTED if name in ARM_EFFECTS])
def test_an_effect_does_in_all_worlds_what_it_does_in_one_arm(effect):
    patch, rng = Patch((one_of(effect),)), np.random.default_rng(3)
    batched = batched_effects(patch, 0.002, "cpu")
    if batched is None:
        assert ARM_EFFECTS[effect].modify_rigid_body is not None
        return
    arms = [ArmEffects(patch, 0.002) for _ in range(3)]
    q = NOMINAL.ready + 0.3 * rng.normal(size=(3, 7))
    for _ in range(12):
        dq, torque = rng.normal(size=(3, 7)), 8 * rng.normal(size=(3, 7))
        q = np.float32(q + 0.002 * dq).astype(float)
        dq, torque = (np.float32(a).astype(float) for a in (dq, torque))
        tensors = [torch.tensor(a, dtype=torch.float32) for a in (q, dq, torque)]
        found = [batched.drive(tensors[2], tensors[0]), batched.extra(*tensors[:2]), *batched.sense(*tensors)]
        one_by_one = [
            [arm.drive(t, a), arm.extra(a, v), *arm.sense(a, v, t)] for arm, a, v, t in zip(arms, q, dq, torque)
        ]
        for tensor, rows in zip(found, zip(*one_by_one)):
            np.testing.assert_allclose(tensor.numpy(), rows, rtol=1e-4, atol=2e-4)


def test_gravity_of_all_worlds_is_that_of_one():
    panda = Patch((PatchEffect("payload", "arm", {"mass": 0.8, "z": 0.1}),)).panda()
    q = NOMINAL.ready + 0.4 * np.random.default_rng(4).normal(size=(20, 7))
    for arm, tilt in ((NOMINAL, (0.0, 0.0)), (panda, (0.02, -0.05))):
        found = BatchedHold("cpu", arm, tilt)(torch.tensor(q, dtype=torch.float32)).numpy()
        np.testing.assert_allclose(found, GravityTorque(arm, tilt)(q), atol=2e-4)


def test_an_arm_with_a_payload_sags_by_what_its_stiffness_leaves():
    patch = Patch((PatchEffect("payload", "arm", {"mass": 0.5, "z": 0.05}),))
    physics = BatchedPhysics(CARD, 1, "cpu", PhysicsConfig(effects=patch))
    for _ in range(10):
        physics.advance()
    q = physics.qpos[:, ARM]
    missing = ArmEffects(patch, 0.005).extra(q[0].numpy().astype(float), np.zeros(7))
    sag = q[0].numpy() - NOMINAL.ready
    stuck = NOMINAL.frictionloss / HOLD_STIFFNESS  # where dry friction holds
    assert np.abs(sag - missing / HOLD_STIFFNESS).max() <= stuck.max() + 1e-3
    assert sag[3] < -0.02


def test_a_world_that_is_placed_anew_knows_nothing_of_the_episode_before():
    patch = Patch((PatchEffect("measurement_delay", "arm", {"delay": 0.02}),))
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(effects=patch))
    for _ in range(2):
        physics.advance()
    qpos = physics.qpos.clone()
    qpos[1, 0] += 0.5
    physics.place(torch.tensor([1]), qpos[1:])
    physics.hold(torch.arange(2), qpos[:, ARM])
    physics.advance()
    assert abs(float(physics.qpos[1, 0] - qpos[1, 0])) < 2e-3  # not torn back to where it was seen before
    assert physics.peak[1, 1].max() < 0.2


def test_policies_see_what_the_sensors_say():
    patch = Patch((PatchEffect("encoder_bias", "panda_joint4", {"bias": 0.01}),))
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(effects=patch))
    for _ in range(2):
        physics.advance()
    off = (physics.seen_q - physics.qpos[:, :9]).numpy()
    np.testing.assert_allclose(off[:, 3], 0.01, atol=1e-6)
    assert np.abs(np.delete(off, 3, axis=1)).max() < 1e-6


@pytest.mark.parametrize("effect", sorted(set(ARM_EFFECTS) - set(SUPPORTED)))
def test_everything_else_is_refused_by_name(effect):
    component = "arm" if ARM_EFFECTS[effect].target is EffectTarget.ARM else "panda_joint3"
    patch = Patch((*PATCH.effects, PatchEffect(effect, component, {ARM_EFFECTS[effect].quantities[0].name: 0.01})))
    with pytest.raises(ValueError, match=f"got {effect} at {component}"):
        check_supported(patch)
    with pytest.raises(ValueError, match=f"training carries {', '.join(SUPPORTED)}"):
        PhysicsConfig(effects=patch)


def test_a_patch_is_read_from_its_file_and_written_into_the_run(tmp_path):
    (tmp_path / "patch.yaml").write_text(dump_patch(PATCH))
    patch = load_effects(tmp_path / "patch.yaml")
    assert patch == PATCH and load_effects(None) == Patch()
    config = dataclasses.asdict(EnvironmentConfig(physics=PhysicsConfig(effects=patch)))
    written = json.loads(json.dumps(config, default=str))["physics"]["effects"]["effects"]
    assert written[0] == {
        "effect": "coulomb_friction",
        "component": "panda_joint4",
        "parameters": {"level": 0.8},
    }


@pytest.mark.parametrize("command", [train, evaluate])
def test_the_commands_refuse_what_they_cannot_carry(tmp_path, monkeypatch, capsys, command):
    loose = Patch((PatchEffect("backlash", "panda_joint3", {"half_play": 0.001}),))
    (tmp_path / "patch.yaml").write_text(dump_patch(loose))
    options = {train: [], evaluate: ["--checkpoint", str(tmp_path / "none.pt")]}[command]
    monkeypatch.setattr(sys, "argv", ["command", *options, "--effects", str(tmp_path / "patch.yaml")])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 2 and "got backlash at panda_joint3" in capsys.readouterr().err


def test_training_with_a_patch_runs(tmp_path, monkeypatch, capsys):
    torch.manual_seed(0)
    (tmp_path / "patch.yaml").write_text(dump_patch(PATCH))
    monkeypatch.setattr(
        sys,
        "argv",
        [
            "train",
            "--out",
            str(tmp_path / "run"),
            "--worlds",
            "8",
            "--iterations",
            "1",
            "--set",
            "rollout=2",
            "--device",
            "cpu",
            "--effects",
            str(tmp_path / "patch.yaml"),
        ],
    )
    train.main()
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["steps"] > 0
    effects = json.loads((tmp_path / "run" / "config.json").read_text())["environment"]["physics"]["effects"]
    assert [e["effect"] for e in effects["effects"]] == [e.effect for e in PATCH.effects]


class TestViewAndScene:
    """Effects beside the arm, which every world has."""

    def test_corners_are_found_where_the_bridge_finds_them(self):
        effects = (
            PatchEffect("camera_extrinsics", "camera", {"y": 0.01, "turn_z": 0.01}),
            PatchEffect("camera_intrinsics", "camera", {"focal": 0.02, "centre_u": 3.0}),
            PatchEffect("lens_distortion", "camera", {"k1": 0.1}),
            PatchEffect("keypoint_bias", "keypoints", {"u": 2.0}),
        )
        patch = Patch(effects)
        corners = box_keypoints(WALL.half_size, np.array([0.5, 0.1, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))
        theirs = CameraEffects(patch).keypoints(lambda times: np.repeat(corners[None], len(times), axis=0), 0)
        ours = BatchedView(patch).keypoints(torch.tensor(corners)[None].float())
        assert np.allclose(ours[0], CAMERA.normalise(theirs), atol=1e-5)
        assert np.abs(theirs - CAMERA.project(corners)[0]).max() > 3

    def test_noise_scatters_as_the_patch_says_and_is_remembered(self):
        view = BatchedView(Patch((PatchEffect("keypoint_noise", "keypoints", {"spread": 3.0, "memory": 0.9}),)))
        points = torch.tensor(box_keypoints(WALL.half_size, np.array([0.5, 0, 0.05]), np.array([1.0, 0, 0, 0])))
        points = points.float().expand(2000, 8, 3)
        torch.manual_seed(0)
        true = BatchedView().keypoints(points)
        first, later = ((view.keypoints(points) - true) * CAMERA.width / 2 for _ in range(2))
        assert first.std() == pytest.approx(3.0, rel=0.05) and later.std() == pytest.approx(3.0, rel=0.05)
        assert (first * later).mean() / 9.0 == pytest.approx(0.9**3, abs=0.05)

    def test_the_past_is_in_proportion_between_periods(self):
        past = Past(2, 2.3, torch.device("cpu"))
        at = [torch.full((2, 8, 3), float(k)) for k in range(5)]
        past.begin(at[0], torch.arange(2))
        for points in at[1:4]:
            past.remember(points)
        age = torch.tensor([0.25, 2.3]).view(2, 1, 1)
        found = past.at(at[4], age)
        assert found[0].eq(3.75).all() and torch.allclose(found[1], torch.tensor(1.7))

    def test_an_observation_is_as_late_as_the_patch_says(self):
        def seen(delay):
            patch = Patch((PatchEffect("camera_latency", "camera", {"delay": delay}),) if delay else ())
            environment = Environment(WALL, "cpu", EnvironmentConfig(worlds=2, physics=PhysicsConfig(effects=patch)))
            steps = []
            for number in range(4):
                environment.physics.qpos[:, OBJECT_POSITION] = torch.tensor([0.5, 0.02 * number, 0.05])
                environment.draws.image_age[:] = environment.view.age / 0.1
                if number == 0:
                    environment._past.begin(environment._corners_now(), torch.arange(2))
                steps.append(environment._seen_corners(environment.objects).mean((0, 1))[1].item())
                environment._past.remember(environment._corners_now())
            return steps

        assert np.allclose(np.subtract(seen(0.0), seen(0.15)), [0, 0.02, 0.03, 0.03], atol=1e-5)

    def test_the_scene_has_another_friction_and_mass(self):
        patch = Patch(
            (
                PatchEffect("gripper_friction", "contact", {"relative": -0.4}),
                PatchEffect("object_mass", "object", {"relative": 0.5}),
            )
        )
        physics = [BatchedPhysics(WALL, 2, "cpu", PhysicsConfig(effects=p)) for p in (Patch(), patch)]
        nominal, heavy = (one.varied.mass[:, one.varied.object_body] for one in physics)
        assert torch.allclose(heavy, 1.5 * nominal)
        nominal, slippery = (one.varied._rubbing[1][1].unique() for one in physics)
        assert torch.allclose(slippery, 0.6 * nominal)

    def test_a_table_at_another_height_is_refused(self):
        with pytest.raises(ValueError, match="table_height at environment"):
            check_supported(Patch((PatchEffect("table_height", "environment", {"height": 0.01}),)))

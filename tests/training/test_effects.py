"""Patches of the gap doctor in the batched simulator."""

import dataclasses
import json
import sys

import numpy as np
import pytest
import torch

from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_effects import RECORDS
from np_effects.patch import Patch, PatchEffect, dump_patch
from np_training import evaluate, train
from np_training.environment.environment import EnvironmentConfig
from np_training.physics.batched import ARM, BatchedPhysics, PhysicsConfig
from np_training.physics.carried_effects import CARRIED, check_carried, load_effects

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


@pytest.mark.parametrize("effect", sorted(set(RECORDS) - set(CARRIED)))
def test_everything_else_is_refused_by_name(effect):
    component = "arm" if effect in ("payload", "base_tilt", "command_delay") else "panda_joint3"
    patch = Patch((*PATCH.effects, PatchEffect(effect, component, {RECORDS[effect].quantities[0].name: 0.01})))
    with pytest.raises(ValueError, match=f"got {effect} at {component}"):
        check_carried(patch)
    with pytest.raises(ValueError, match=f"training carries {', '.join(CARRIED)}"):
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
    late = Patch((PatchEffect("command_delay", "arm", {"delay": 0.002}),))
    (tmp_path / "patch.yaml").write_text(dump_patch(late))
    options = {train: [], evaluate: ["--checkpoint", str(tmp_path / "none.pt")]}[command]
    monkeypatch.setattr(sys, "argv", ["command", *options, "--effects", str(tmp_path / "patch.yaml")])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 2 and "got command_delay at arm" in capsys.readouterr().err


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
            "--rollout",
            "2",
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

"""The blind test's arm of six hinges: its model file and its physics match, and its sets are run like the others."""

import json
import shlex
import sys
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_blind.arm import set as blind
from np_blind.arm import six_motion
from np_blind.arm.evaluation.scoring import modules
from np_blind.arm.generate import recording_path, reference_path
from np_blind.arm.plant.rigid_arm import RigidArms
from np_blind.arm.sampling import six_hinges
from np_blind.arm.sampling.cases import baseline_case, draw_cases, make_physics
from np_blind.arm.sampling.key import make_key

WHICH = "development_six"
MODEL = mujoco.MjModel.from_xml_path(str(six_hinges.MODEL))
states = arrays(float, 6, elements=st.floats(-2, 2))
SHORT = 1500  # periods


@pytest.fixture
def short(monkeypatch):
    """Only the first seconds of the motion."""
    rows = tuple(part[:SHORT] for part in six_motion.targets())
    monkeypatch.setattr(six_motion, "targets", lambda: rows)


@settings(deadline=None, max_examples=30)
@given(states, states)
def test_rigid_body_terms_are_mujocos_of_the_model_that_the_diagnosis_is_given(q, dq):
    arm = six_hinges.chain()
    matrix, velocity, weight = RigidArms(arm.inertials(1), arm.joint_frames).terms(q[None], dq[None])
    data, mass = mujoco.MjData(MODEL), np.zeros((6, 6))
    data.qpos[:], data.qvel[:] = q, dq
    mujoco.mj_forward(MODEL, data)
    mujoco.mj_fullM(MODEL, data, mass)
    assert np.allclose(matrix[0] + np.diag(arm.armature), mass, atol=1e-10)
    assert np.allclose((velocity + weight)[0], data.qfrc_bias, atol=1e-9)
    assert six_hinges.joint_names() == tuple(MODEL.joint(j).name for j in range(6))
    physics = six_hinges.nominal_physics(1)
    assert np.allclose(physics.coulomb_forward[0], MODEL.dof_frictionloss)
    assert np.allclose(physics.viscous_backward[0], MODEL.dof_damping)


def test_its_motion_keeps_to_its_limits_and_is_smooth():
    position, speed, acceleration = six_motion.targets()
    low, high = MODEL.jnt_range.T
    assert (
        ((position > low) & (position < high)).all() and np.abs(speed).max() < 1.5 and np.abs(acceleration).max() < 10
    )
    assert np.ptp(position, axis=0).min() > 0.5 and not speed[[0, -1]].any()
    assert 0.01 < np.mean(np.abs(np.abs(speed) - 0.02) < 1e-6) < 0.5  # slow triangles


def test_cases_are_of_its_own_joints_and_effects():
    faults = [f for k in range(40) for case in draw_cases(60, 600 + k, WHICH) for f in case.faults]
    assert {f.effect for f in faults} == set(six_hinges.EFFECTS) < set(modules())
    for effect, (_, joints) in six_hinges.LIMITS.items():
        assert {f.joint for f in faults if f.effect == effect} == (set(joints) or {None}), effect
    assert {f.component for f in faults} == {*six_hinges.joint_names(), "arm"}
    assert all(0.8 <= f.size <= six_hinges.largest(f.effect) for f in faults)
    entry = next(e for e in json.loads(make_key(6, 600, WHICH))["cases"] if e["faults"])
    assert entry["faults"][0]["magnitude"] > 0 and entry["faults"][0]["component"] in (*six_hinges.joint_names(), "arm")


def test_every_effect_changes_its_arm_and_nothing_else_does():
    cases = draw_cases(60, 600, WHICH)
    after, truths = make_physics(cases)
    before, _ = make_physics([baseline_case(case) for case in cases])
    for i, case in enumerate(cases):
        same = np.allclose(after.inertials.mass[i], before.inertials.mass[i])
        assert same == ("payload" not in {f.effect for f in case.faults})
        assert bool(truths[i]) == (case.kind == "single")


def test_a_recording_holds_the_torque_of_the_motion_and_of_what_was_added(short, tmp_path):
    physics = six_hinges.nominal_physics(2)
    physics.noise[:] = 0.0
    physics.offset[1, 3] = 0.4
    paths = [tmp_path / name for name in "ab"]
    assert six_motion.record(physics, [[1], [2]], paths) == {}
    arm, left = six_hinges.chain(), []
    for path in paths:
        rows = np.load(path / six_motion.FILE)
        q, dq = rows["q_rad"], rows["dq_rad_s"]
        assert q.shape == (SHORT - six_motion.FIRST, 6) and np.allclose(np.diff(rows["t_s"]), 0.002)
        matrix, velocity, weight = RigidArms(arm.inertials(len(q)), arm.joint_frames).terms(q, dq)
        acceleration = np.gradient(dq, rows["t_s"], axis=0)
        rigid = np.einsum("nij,nj->ni", matrix, acceleration) + arm.armature * acceleration + velocity + weight
        moving = np.where(np.abs(dq) > 0.1, 1.0, np.nan)
        friction = physics.coulomb_forward[0] * np.sign(dq) + physics.viscous_forward[0] * dq
        left.append(np.nanmean(moving * (rows["tau_J_Nm"] - rigid - friction), axis=0))
    assert np.abs(left[0]).max() < 0.05
    assert left[1] - left[0] == pytest.approx(0.4 * np.eye(6)[3], abs=0.02)


def test_an_arm_that_runs_away_leaves_the_others(short, tmp_path):
    physics = six_hinges.nominal_physics(2)
    physics.viscous_forward[0] = physics.viscous_backward[0] = -400.0
    lost = six_motion.record(physics, [[1], [2]], [tmp_path / "a", tmp_path / "b"])
    assert set(lost) == {0} and not (tmp_path / "a").exists()
    assert np.isfinite(np.load(tmp_path / "b" / six_motion.FILE)["tau_J_Nm"]).all()


def test_the_diagnosis_is_given_the_model_and_both_days(short, tmp_path, monkeypatch):
    monkeypatch.setattr(blind, "workers", ThreadPoolExecutor)
    diagnosis = (
        "import json, pathlib, sys; new, _, old, option, model, _, out = sys.argv[1:]; out = pathlib.Path(out); "
        "assert option == '--model' and model.endswith('six_hinges.xml') and new.endswith('.npz') and new != old; "
        "(out / 'report.json').write_text(json.dumps({'verdict': 'no_gap', 'effects': [], 'where': []})); "
        "(out / 'patch.yaml').write_text('effects: []')"
    )
    command = ["--cases", "2", "--seed", str(600), "--set", WHICH, "--keep", "--out", str(tmp_path)]
    assert blind.main([*command, "--diagnosis", shlex.join([sys.executable, "-c", diagnosis])]) == 0
    figures = json.loads((tmp_path / "results.json").read_text())["figures"]
    assert figures["errors"] == 0 and figures["cases"] == 2 and figures["set"] == WHICH
    assert recording_path(reference_path(tmp_path, 1)).exists()

"""Whether a policy's ONNX file has the outputs of PyTorch with its weights, and how long each takes."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from np_control.kinematics import forward_kinematics
from np_description.domains import Task, sample_task
from np_description.panda import FINGER_MAX, NOMINAL
from np_description.weights.released import WeightsError, sha256
from np_perception.pose_estimation import project_keypoints
from np_policy import action, hand_pose
from np_policy.contract import POST_CONTACT, PolicyContract, damping_floor, policy_metadata, residual_limits
from np_policy.onnx.export import kind_and_domain
from np_policy.onnx.runtime import open_session
from np_policy.onnx.signature import SIGNATURES, SOURCE
from np_policy.torch_network import load_network

PARITY = 1e-5
"""The largest difference of an output from PyTorch's: m, of rotation matrices, of actions; stiffness as a share of itself."""


def check_parity(file: Path, weights: Path, steps: int = 1000) -> dict[str, object]:
    """Differences by output over `steps` drawn inputs, and p50 and p99 of both in ms.

    Joints are drawn 0.4 rad about the ready posture, speeds 0.3 rad/s about zero, keypoints from the task with 1 px of noise.
    Raises WeightsError where the file is broken or was exported from other weights.
    """
    metadata = policy_metadata(file)
    kind, domain = kind_and_domain(metadata, file)
    if metadata.get(SOURCE) != sha256(weights):
        raise WeightsError(
            f"policy: {file} was not exported from {weights} (other sha256); export_policy writes it anew"
        )
    PolicyContract.of(kind, domain).check(file)
    session, names = open_session(file), list(SIGNATURES[kind].outputs)
    network, limits = load_network(weights, kind, domain, PolicyContract.of(kind, domain)), None
    if kind == POST_CONTACT:
        limits = residual_limits(weights), damping_floor(weights)
    rng, worst, times = np.random.default_rng(0), dict.fromkeys(names, 0.0), ([], [])
    for _ in range(steps):
        inputs = {name: value for name, value in _draw(domain, rng).items() if name in SIGNATURES[kind].inputs}
        began = time.perf_counter()
        found = session.run(names, {name: value[None] for name, value in inputs.items()})
        between = time.perf_counter()
        expected = _decode(network(*inputs.values()), inputs, limits)
        times[0].append(between - began)
        times[1].append(time.perf_counter() - between)
        for name, value, wanted in zip(names, found, expected, strict=True):
            scale = np.abs(wanted) if name == "stiffness" else 1.0
            worst[name] = max(worst[name], float(np.max(np.abs(value[0] - wanted) / scale)))
    latency = {
        f"{which}_p{share}_ms": round(1e3 * float(np.percentile(values, share)), 3)
        for which, values in zip(("onnx", "torch"), times)
        for share in (50, 99)
    }
    return {"steps": steps, "difference": worst, **latency, "parity": max(worst.values()) <= PARITY}


def _draw(domain: Task, rng: np.random.Generator) -> dict[str, np.ndarray]:
    here, there = (project_keypoints(domain, pose)[:, :2] for pose in sample_task(domain, rng))
    return {
        "q": np.concatenate([NOMINAL.ready + rng.normal(0.0, 0.4, 7), rng.uniform(0, FINGER_MAX, 2)]),
        "dq": np.concatenate([rng.normal(0.0, 0.3, 7), rng.normal(0.0, 0.02, 2)]),
        "keypoints": here + rng.normal(0.0, 1.0, here.shape),
        "goal_keypoints": there,
        "last_action": rng.uniform(-1, 1, action.SIZE),
    }


def _decode(output: np.ndarray, inputs: dict[str, np.ndarray], limits) -> tuple:
    if limits is None:
        return *hand_pose.decode(output), output
    target = action.decode(output, *forward_kinematics(inputs["q"][:7]), *limits)
    return target.position, target.rotation, target.stiffness, target.damping_ratio, output

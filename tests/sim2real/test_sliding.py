"""Friction from free slides of a block whose friction is added up over points, on a tilted table, and from real tosses."""

import os
from pathlib import Path

import numpy as np
import pytest
from push_generator import World, support
from scipy.spatial.transform import Rotation
from sim2real.task.sliding import friction, slides

REAL = Path(os.environ.get("NP_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))
HALF, STEP, EVERY, GRAVITY = 0.05, 0.001, 7, 9.81
RADIUS = 0.383 * 2 * HALF


def thrown(mu, rng, tilt=(0.004, -0.003), noise=1e-4):
    """Times (n,), positions (b, n, 3) and rotations (b, n, 3, 3) of blocks that slide with friction mu (b,) until they rest."""
    points, share = support(World(weight_friction=1.0, half_side=HALF))
    count = len(mu)
    angle = rng.uniform(-np.pi, np.pi, count)
    velocity = rng.uniform(0.4, 1.0, (count, 1)) * np.column_stack([np.cos(angle), np.sin(angle)])
    rate, yaw, place = rng.normal(0, 4, count), angle.copy(), np.zeros((count, 2))
    rows = []
    for _ in range(600):
        rows.append(np.column_stack([place, yaw]))
        cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        arms = np.stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]], axis=-1)
        v = velocity[:, None] + rate[:, None, None] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
        pull = -(mu * GRAVITY)[:, None, None] * share[:, None] * v / np.sqrt((v * v).sum(-1, keepdims=True) + 1e-6)
        velocity = velocity + STEP * (pull.sum(1) + GRAVITY * np.array(tilt))
        moment = (arms[..., 0] * pull[..., 1] - arms[..., 1] * pull[..., 0]).sum(1)
        rate = rate + STEP * moment / (2 / 3 * HALF**2)
        place, yaw = place + STEP * velocity, yaw + STEP * rate
    seen = np.array(rows)[::EVERY].swapaxes(0, 1)
    position = np.concatenate([seen[..., :2], np.full((*seen.shape[:2], 1), 0.02)], axis=2)
    position += noise * rng.normal(size=position.shape)
    turns = (seen[..., 2] + 1e-3 * rng.normal(size=seen.shape[:2])).reshape(-1, 1)
    turned = Rotation.from_rotvec(turns * [0.0, 0.0, 1.0]).as_matrix()
    return np.arange(seen.shape[1]) * STEP * EVERY, position, turned.reshape(*seen.shape[:2], 3, 3)


def test_friction_of_free_slides_is_found_and_its_interval_holds():
    rng = np.random.default_rng(0)
    held = []
    for mu in rng.uniform(0.15, 0.4, 30):
        time, position, turned = thrown(mu * np.exp(0.05 * rng.normal(size=10)), rng)
        found = friction([one for p, r in zip(position, turned) for one in slides(time, p, r, RADIUS)])
        assert found.slides >= 8 and found.mu == pytest.approx(mu, rel=0.12)
        held.append(found.low < mu < found.high)
    assert np.mean(held) >= 0.85


def test_a_tilt_of_the_table_is_no_friction():
    rng = np.random.default_rng(1)
    time, position, turned = thrown(np.full(30, 0.25), rng, tilt=(0.015, 0.0))
    found = friction([one for p, r in zip(position, turned) for one in slides(time, p, r, RADIUS)])
    assert found.mu == pytest.approx(0.25, abs=0.01) and found.tilt == pytest.approx((0.015, 0.0), abs=0.005)


def test_what_does_not_slide_or_does_not_fit_is_refused():
    time, position, turned = thrown(np.full(1, 0.3), np.random.default_rng(2))
    still = np.tile(position[0, -1], (len(time), 1))
    assert slides(time, still, turned[0], RADIUS) == []
    with pytest.raises(ValueError, match="expected 3 or more slides, got 0"):
        friction([])
    with pytest.raises(ValueError, match=r"expected times \(n,\), positions"):
        slides(time, position[0, :, :2], turned[0], RADIUS)
    with pytest.raises(ValueError, match="expected finite poses and stamps that increase"):
        slides(time[::-1], position[0], turned[0], RADIUS)


@pytest.mark.skipif(not (REAL / "cube_toss_contactnets").is_dir(), reason="the tosses are not in the repository")
def test_real_tosses_of_a_cube():
    with np.load(REAL / "cube_toss_contactnets" / "cube_tosses.npz") as data:
        rows = [data[name].astype(float) for name in data.files[:200]]
    half, found = 0.0524, []
    for row in rows:
        turned = Rotation.from_quat(row[:, [4, 5, 6, 3]]).as_matrix()
        found += slides(np.arange(len(row)) / 148, row[:, :3] * half, turned, 0.383 * 2 * half)
    known = friction(found)
    assert (
        known.low < 0.223 and known.high > 0.206
    )  # quartiles of the deceleration that others found in the same tosses
    assert known.slides > 100 and known.spread < 0.03 and np.abs(known.tilt).max() < 0.003

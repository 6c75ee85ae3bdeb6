"""The force reflex's estimate, filter and thresholds."""

import numpy as np
import pytest
import torch

from np_control.kinematics import jacobian
from np_description.force_reflex import (
    FORCE_REFLEX,
    external_torque,
    filter_step,
    hand_wrench,
    threshold_share,
)
from np_description.panda import NOMINAL

POSES = NOMINAL.ready + np.random.default_rng(0).uniform(-0.3, 0.3, (20, 7))
WRENCHES = np.random.default_rng(1).normal(size=(20, 6)) * [30, 30, 30, 5, 5, 5]


def explained(q, wrench):
    """Joint torques (..., 7) that a wrench at T_E gives."""
    return (np.swapaxes(jacobian(q), -1, -2) @ wrench[..., None])[..., 0]


def test_a_wrench_at_the_hand_is_found_from_the_joints_torques():
    found = hand_wrench(external_torque(-explained(POSES, WRENCHES) + 3.0, 3.0), jacobian(POSES))
    np.testing.assert_allclose(found, WRENCHES, atol=1.5)


def test_near_a_singularity_the_wrench_is_bounded():
    stretched = np.zeros(7)  # the elbow is straight, the wrist in line with the base
    assert np.linalg.svd(jacobian(stretched))[1][-1] < 1e-6
    torque = np.random.default_rng(2).normal(size=(50, 7))
    wrench = hand_wrench(torque, np.broadcast_to(jacobian(stretched), (50, 6, 7)), 0.02)
    assert (np.linalg.norm(wrench, axis=-1) <= np.linalg.norm(torque, axis=-1) / 0.04).all()


def test_arrays_and_tensors_give_the_same_in_any_batch():
    torque, matrix = explained(POSES, WRENCHES), jacobian(POSES)
    wrench = hand_wrench(torque, matrix)
    one = np.stack([hand_wrench(t, m) for t, m in zip(torque, matrix)])
    np.testing.assert_allclose(one, wrench)
    tensors = torch.as_tensor(torque).reshape(4, 5, 7), torch.as_tensor(matrix).reshape(4, 5, 6, 7)
    found = hand_wrench(*tensors)
    np.testing.assert_allclose(found.reshape(20, 6), wrench)
    share = threshold_share(tensors[0], found)
    np.testing.assert_allclose(share.reshape(20), threshold_share(torque, wrench))
    filtered = filter_step(torch.zeros_like(found), found, 0.002)
    np.testing.assert_allclose(filtered.reshape(20, 6), filter_step(np.zeros_like(wrench), wrench, 0.002))


def test_the_filter_reaches_63_percent_of_a_step_after_its_time_constant_whatever_the_period():
    for steps in (1, 5, 10):
        value = 0.0
        for _ in range(steps):
            value = filter_step(value, 1.0, FORCE_REFLEX.time_constant / steps)
        assert value == pytest.approx(1 - np.exp(-1))


def test_the_filter_lies_between_its_last_value_and_the_raw_one_and_keeps_a_constant():
    rng = np.random.default_rng(3)
    last, raw = rng.normal(size=(2, 30, 7))
    after = filter_step(last, raw, 0.002)
    assert ((after - last) * (raw - after) > 0).all()
    np.testing.assert_array_equal(filter_step(raw, raw, 0.002), raw)


def test_the_share_is_one_exactly_at_each_threshold_in_every_direction():
    still, no_wrench = np.zeros(7), np.zeros(6)
    for joint, limit in enumerate(FORCE_REFLEX.torques()):
        assert threshold_share(-limit * np.eye(7)[joint], no_wrench) == pytest.approx(1)
    directions = np.random.default_rng(4).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    none = np.zeros_like(directions)
    for wrench in (
        np.concatenate([FORCE_REFLEX.force * directions, none], axis=-1),
        np.concatenate([none, FORCE_REFLEX.moment * directions], axis=-1),
    ):
        np.testing.assert_allclose(threshold_share(np.broadcast_to(still, (20, 7)), wrench), 1)
        np.testing.assert_allclose(threshold_share(np.broadcast_to(still, (20, 7)), 0.6 * wrench), 0.6)

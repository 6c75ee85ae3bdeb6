"""What the camera sees past the arm, without an image: against rays that MuJoCo casts."""

import mujoco
import numpy as np
import pytest
import torch

from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD
from np_description.keypoints import box_keypoints
from np_description.scene import load_model
from np_training.detector.scenes import sample_states
from np_training.environment.sight import ENOUGH, TOUCHING, Sight
from np_training.tasks.poses import Poses

ARM, OBJECT = np.array([0, 1, 0, 0, 0, 0], np.uint8), np.array([0, 0, 0, 1, 0, 0], np.uint8)  # groups of geoms


def rays(model: mujoco.MjModel, state: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[bool]]:
    """Positions and rotations of the geoms in a state (16,), and whether rays from the camera meet each of the points (8, 3) first."""
    data = mujoco.MjData(model)
    data.qpos[:] = state
    mujoco.mj_kinematics(model, data)
    eye, free = np.asarray(CAMERA.position), []
    for point in points:
        line = point - eye
        to_arm, to_object = (
            mujoco.mj_ray(model, data, eye, line, group, 1, -1, np.zeros(1, np.int32), None) for group in (ARM, OBJECT)
        )
        free.append(not (0 <= to_arm < TOUCHING or 0 <= to_object < 1 - 1e-4))  # shares of the line
    return data.geom_xpos.copy(), data.geom_xmat.reshape(-1, 3, 3).copy(), free


@pytest.mark.parametrize("domain", [CARD, BUMP], ids=lambda d: d.name)
def test_corners_are_in_sight_where_rays_of_mujoco_meet_nothing_before_them(domain):
    model = load_model(domain)
    states = sample_states(domain, 200, torch.Generator().manual_seed(3))
    states = states[states[:, 11] > 0]  # some images are without the object
    objects = Poses(states[:, 9:12], states[:, 12:])
    points = box_keypoints(domain.half_size, objects.position, objects.quaternion)
    rows = [rays(model, *pair) for pair in zip(states.double().numpy(), points.double().numpy())]
    position, rotation = (torch.tensor(np.stack(column), dtype=torch.float32) for column in list(zip(*rows))[:2])
    truth = torch.tensor([row[2] for row in rows])
    seen = Sight(model, "cpu").seen(position, rotation, objects, points)
    assert (seen == truth).float().mean() > 0.99
    assert 0.1 < truth.float().mean() < 0.9
    hidden = Sight(model, "cpu").hidden(position, rotation, objects, points)
    assert ((hidden == 0) == (seen.sum(-1) >= ENOUGH)).all() and hidden.max() > 0.3


def test_nothing_is_hidden_by_an_arm_that_is_elsewhere():
    model = load_model(CARD)
    far = torch.zeros(1, model.ngeom, 3) + torch.tensor([-5.0, 0.0, 0.0])
    still = torch.eye(3).expand(1, model.ngeom, 3, 3)
    objects = Poses(torch.tensor([[0.5, 0.0, CARD.half_size[2]]]), torch.tensor([[1.0, 0.0, 0.0, 0.0]]))
    points = box_keypoints(CARD.half_size, objects.position, objects.quaternion)
    seen = Sight(model, "cpu").seen(far, still, objects, points)
    upper = points[..., 2] > CARD.half_size[2]
    assert seen[upper].all()  # and of the lower ones those in front
    assert (seen == (upper | (points[..., 0] > 0.5))).all()

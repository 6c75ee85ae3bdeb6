"""Which corners of the object the arm does not hide from the camera: no detector finds a hidden one.

A card below an upright hand shows no corner at all, and with two of them in sight the detector places all eight
(run diaries at the tag lab-notebook-2026-11). Lines of sight are held against the capsules and boxes that the scene draws; no image is rendered.
"""

from __future__ import annotations

import mujoco
import numpy as np
import torch

from np_common.rotations import matrix_from_quaternion
from np_description.camera import CAMERA
from np_description.keypoints import CORNERS
from np_training.tasks.poses import Poses

ENOUGH = 3  # corners in sight, with which the detector has six usable ones in .96 of the images
ROBOT_GROUP = 1  # of geoms, in np_description.scene
TOUCHING = 0.99  # share of a line of sight that has to be free: what touches a corner does not hide it


class Sight:
    """The arm's shapes in the way of the nominal camera."""

    def __init__(self, model: mujoco.MjModel, device: str | torch.device) -> None:
        options = dict(dtype=torch.float32, device=device)
        capsules, boxes = (
            np.flatnonzero((model.geom_group == ROBOT_GROUP) & (model.geom_type == kind))
            for kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX)
        )
        self._capsules, self._boxes = (torch.tensor(geoms, device=device) for geoms in (capsules, boxes))
        self._radius, self._half_length = torch.tensor(model.geom_size[capsules, :2].T, **options)
        self._half_size = torch.tensor(model.geom_size[boxes], **options)
        self._eye = torch.tensor(CAMERA.position, **options)
        self._signs = torch.tensor(np.asarray(CORNERS), **options)

    def hidden(
        self, position: torch.Tensor, rotation: torch.Tensor, objects: Poses, points: torch.Tensor
    ) -> torch.Tensor:
        """How far the camera is from seeing enough (n,): 1 with none of the corners in sight, 0 with ENOUGH of them and more."""
        seen = self.seen(position, rotation, objects, points)
        return (1 - seen.sum(-1) / ENOUGH).clamp(min=0)

    def seen(
        self, position: torch.Tensor, rotation: torch.Tensor, objects: Poses, points: torch.Tensor
    ) -> torch.Tensor:
        """Whether (n, 8) each corner is in sight. position (n, geoms, 3) m, rotation (n, geoms, 3, 3): of the scene's geoms;
        points (n, 8, 3) m: the corners of the objects (n,)."""
        ray = points - self._eye
        covered = _through_capsules(
            self._eye,
            ray,
            position[:, self._capsules],
            rotation[:, self._capsules, :, 2] * self._half_length[:, None],
            self._radius,
        ) | _through_boxes(self._eye, ray, position[:, self._boxes], rotation[:, self._boxes], self._half_size)
        # A corner is turned to the camera if one of the three faces that meet there is.
        normals = matrix_from_quaternion(objects.quaternion)[:, None] * self._signs[None, :, None, :]  # columns
        facing = (-(ray[..., None] * normals).sum(-2) > 0).any(-1)
        return facing & ~covered


def _through_capsules(
    eye: torch.Tensor, ray: torch.Tensor, centre: torch.Tensor, half_axis: torch.Tensor, radius: torch.Tensor
) -> torch.Tensor:
    """Whether (n, 8) lines from the eye along ray (n, 8, 3) come within `radius` (k,) of a capsule's axis, centre and half_axis
    (n, k, 3): the distance of two segments, Ericson, Real-Time Collision Detection, 5.1.9."""
    first, axis = ray[:, :, None], 2 * half_axis[:, None]
    between = (eye - centre + half_axis)[:, None]
    a, e = (first * first).sum(-1), (axis * axis).sum(-1).clamp(min=1e-12)
    b, c, f = (first * axis).sum(-1), (first * between).sum(-1), (axis * between).sum(-1)
    along = ((b * f - c * e) / (a * e - b * b).clamp(min=1e-12)).clamp(0, TOUCHING)
    across = ((b * along + f) / e).clamp(0, 1)
    along = ((b * across - c) / a).clamp(0, TOUCHING)
    gap = between + first * along[..., None] - axis * across[..., None]
    return ((gap * gap).sum(-1) < radius**2).any(-1)


def _through_boxes(
    eye: torch.Tensor, ray: torch.Tensor, centre: torch.Tensor, rotation: torch.Tensor, half_size: torch.Tensor
) -> torch.Tensor:
    """Whether (n, 8) lines from the eye along ray (n, 8, 3) go through a box: slabs, in the frames of the boxes, centre (n, k, 3)
    and rotation (n, k, 3, 3)."""
    origin = torch.einsum("nkij,nki->nkj", rotation, eye - centre)[:, None]
    direction = torch.einsum("nkij,nmi->nmkj", rotation, ray)
    direction = torch.where(direction.abs() < 1e-9, torch.full_like(direction, 1e-9), direction)
    ends = (-half_size - origin) / direction, (half_size - origin) / direction
    enters = torch.minimum(*ends).amax(-1)
    leaves = torch.maximum(*ends).amin(-1)
    return ((leaves >= enters.clamp(min=0)) & (enters <= TOUCHING)).any(-1)

"""What is drawn anew for every episode of a world: physics, sensors, camera, limits (np_training.tasks.randomisation)."""

from __future__ import annotations

import numpy as np
import torch

from np_common.rotations import matrix_from_vector
from np_description.camera import CAMERA
from np_description.panda import NOMINAL
from np_policy.action import RATE
from np_training.physics.batched import BatchedPhysics
from np_training.tasks.randomisation import DELAY_STEP, Conditions

PERIOD = 1 / RATE  # s
START_SLACK = 0.1  # rad, between where an episode begins and the range that is allowed in it


class EpisodeDraws:
    """Draws of all worlds.

    keypoint_bias (worlds, 1, 2) normalised image units; image_age (worlds, 1, 1) policy periods; camera_turn (worlds, 3, 3) and
    camera_shift (worlds, 1, 3) m: how the camera sees the base frame turned and shifted about its own place; factors (worlds, 3): of
    table friction, finger friction and mass; range (2, worlds, 7) rad: beyond which the reflex ends an episode; force_margin
    (worlds,): share of the force reflex's thresholds.
    """

    def __init__(self, physics: BatchedPhysics, view_age: float, generator: torch.Generator) -> None:
        """view_age: of an image without drawn latency, s; generator: on the physics' device, shared with its owner."""
        self._physics, self._view_age, self._generator = physics, view_age, generator
        n, device = physics.worlds, physics.device
        self.keypoint_bias = torch.zeros(n, 1, 2, device=device)
        self.image_age = torch.zeros(n, 1, 1, device=device)
        self.camera_turn = torch.eye(3, device=device).repeat(n, 1, 1)
        self.camera_shift = torch.zeros(n, 1, 3, device=device)
        self.factors = torch.ones(n, 3, device=device)
        self._mechanical = torch.tensor(
            np.stack([NOMINAL.position_lower, NOMINAL.position_upper]), dtype=torch.float32, device=device
        )
        self.range = self._mechanical[:, None].repeat(1, n, 1)
        self.force_margin = torch.ones(n, device=device)

    def draw(self, c: Conditions, where: torch.Tensor, q: torch.Tensor) -> None:
        """Draw for the worlds `where` (n,) under conditions c, with the arm at joints q (n, 7) rad."""
        n, physics = len(where), self._physics
        delay = torch.randint(c.delay[0], c.delay[1] + 1, (n,), generator=self._generator, device=physics.device)
        physics.delay[where] = (delay * round(DELAY_STEP / physics.config.timestep)).int()
        self.keypoint_bias[where] = c.keypoint_bias * self._normal(n, 2)[:, None]
        if c.randomises_physics:
            self._draw_physics(c, where)
        if c.finger_length or c.finger_tilt:
            length, turn = (self._uniform(k * n, -1.0, 1.0).reshape(n, 2, -1) for k in (2, 6))
            turn[..., 2] = 0  # about its sides, not about the finger
            physics.varied.bend(where, c.finger_length * length[..., 0], c.finger_tilt * turn)
        if c.support is not None:
            physics.varied.support(where, self._uniform(3 * n, *c.support).reshape(n, 3))
        if c.camera_position or c.camera_rotation:
            self.camera_turn[where] = matrix_from_vector(c.camera_rotation * self._normal(n, 3))
            self.camera_shift[where] = c.camera_position * self._normal(n, 3)[:, None]
        self.image_age[where] = (self._view_age + self._uniform(n, *c.image_latency)[:, None, None]) / PERIOD
        self.force_margin[where] = self._uniform(n, *c.force_margin)
        self._draw_limits(where, q, self._uniform(n, *c.limit_margin))

    def show_by_camera(self, c: Conditions, points: torch.Tensor) -> torch.Tensor:
        """Points (worlds, k, 3) m where a camera that is off shows them to who takes it to be where it is said to be."""
        if not (c.camera_position or c.camera_rotation):
            return points
        place = torch.tensor(CAMERA.position, dtype=points.dtype, device=points.device)
        return (points - place) @ self.camera_turn.transpose(1, 2) + place + self.camera_shift

    def _draw_physics(self, c: Conditions, where: torch.Tensor) -> None:
        n, varied = len(where), self._physics.varied
        factors = [self._uniform(n, *c.table_friction), self._uniform(n, *c.finger_friction), self._factor(n, c.mass)]
        self.factors[where] = torch.stack(factors, -1)
        varied.randomise(where, *factors, self._uniform(n, *c.housing_friction))
        ranges = (c.stiffness, c.damping, c.time_constant, c.friction_stiffness)
        onset = self._uniform(n, *c.onset) if c.onset != (0.0, 0.0) else 0.0
        varied.stiffen(where, *(self._factor(n, ends) for ends in ranges), onset)
        worn = (c.joint_friction, c.joint_damping, c.armature)
        varied.wear(where, *(self._factor(7 * n, ends).reshape(n, 7) for ends in worn))
        varied.shift_centre(where, c.centre * self._uniform(3 * n, -1.0, 1.0).reshape(n, 3))

    def _draw_limits(self, where: torch.Tensor, q: torch.Tensor, margin: torch.Tensor) -> None:
        """Let the reflex come at shares `margin` (n,) of the limits; where an episode begins at q (n, 7) rad is within them."""
        self._physics.margin[where] = margin
        lower, upper = self._mechanical
        middle, half = (lower + upper) / 2, (upper - lower) / 2 * margin[:, None]
        self.range[0, where] = torch.minimum(middle - half, q - START_SLACK).maximum(lower)
        self.range[1, where] = torch.maximum(middle + half, q + START_SLACK).minimum(upper)

    def _normal(self, rows: int, columns: int) -> torch.Tensor:
        return torch.randn(rows, columns, generator=self._generator, device=self._physics.device)

    def _uniform(self, count: int, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(count, generator=self._generator, device=self._physics.device)

    def _factor(self, count: int, ends: tuple[float, float]) -> torch.Tensor:
        """(count,) numbers drawn evenly in their logarithm."""
        return torch.exp(self._uniform(count, *np.log(ends)))

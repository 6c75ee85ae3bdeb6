"""Domain randomisation: what varies between episodes and between steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Conditions:
    """Ranges of factors drawn an episode: table_friction, finger_friction, mass; delay: physics steps (5 ms)
    until a target takes effect; keypoint_bias: standard deviation an episode, normalised image units.
    Standard deviations drawn a step: torque_noise Nm, keypoint_noise normalised, joint_noise rad,
    velocity_noise rad/s. start_position m, start_rotation rad: how far an episode's start misses the chosen
    contact."""

    table_friction: tuple[float, float] = (1.0, 1.0)
    finger_friction: tuple[float, float] = (1.0, 1.0)
    mass: tuple[float, float] = (1.0, 1.0)
    delay: tuple[int, int] = (4, 4)
    torque_noise: float = 0.0
    keypoint_noise: float = 0.0
    keypoint_bias: float = 0.0
    joint_noise: float = 0.0
    velocity_noise: float = 0.0
    start_position: float = 0.0
    start_rotation: float = 0.0

    @property
    def randomises_physics(self) -> bool:
        """Whether any model field differs between worlds."""
        return any(r != (1.0, 1.0) for r in (self.table_friction, self.finger_friction, self.mass))


NOMINAL_CONDITIONS = Conditions()

PAPER = Conditions(
    table_friction=(0.7, 1.3),
    finger_friction=(0.9, 1.1),
    mass=(0.7, 1.3),
    delay=(1, 8),
    torque_noise=0.03,
    keypoint_noise=0.03,
    keypoint_bias=0.01,
    joint_noise=0.01,
    velocity_noise=0.01,
    start_position=0.006,
    start_rotation=0.03,
)
"""Friction, mass, torque, keypoints and sensors are the paper's; delay, bias and start errors are ours."""

GROUPS = {
    "friction": ("table_friction", "finger_friction"),
    "mass": ("mass",),
    "torque_noise": ("torque_noise",),
    "keypoint_noise": ("keypoint_noise", "keypoint_bias"),
    "sensor_noise": ("joint_noise", "velocity_noise"),
}
"""What is widened to see which part of the randomisation matters, by name."""


def widen(conditions: Conditions, groups: Iterable[str], factor: float = 2.0) -> Conditions:
    """Conditions with the ranges of some `GROUPS` `factor` times as far from nominal, noise `factor` times as
    strong."""
    wide = {}
    for name in (name for group in groups for name in GROUPS[group]):
        value = getattr(conditions, name)
        wide[name] = tuple(1 + factor * (end - 1) for end in value) if isinstance(value, tuple) else factor * value
    return dataclasses.replace(conditions, **wide)


TWICE = widen(PAPER, GROUPS)
"""Friction, mass and noise at twice the range that training draws from."""

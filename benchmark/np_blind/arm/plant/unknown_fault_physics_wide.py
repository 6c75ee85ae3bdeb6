"""The physics of the faults out of the catalogue that sets with a wide background have (out_of_catalogue_wide.py)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from np_blind.arm.plant.physics import Physics

ONSET = 0.05  # rad/s, over which a cover comes to touch
POWER = 10.0  # W, at which a supply's sag is given
SHALLOW = 0.3  # damping ratio of a notch


class WideUnknownFaultPhysics:
    """State and torques of these faults of B arms; all arrays (B, 7).

    used: what of `physics` is not its default; q: where the links begin; step: s.
    """

    def __init__(self, physics: Physics, used: Collection[str], q: np.ndarray, step: float):
        self._physics, self._used, self._step = physics, used, step
        self._snapped = np.where(q > physics.snap_angle, 1.0, -1.0)
        self._lip, self._power = np.zeros_like(q), np.zeros_like(q)
        self._slow = self._followed = self._passed_sum = None  # they begin where the drives do
        self._passed = np.zeros_like(q)

    def friction(self, speed: np.ndarray) -> np.ndarray | float:
        """Coulomb level on top of the joint's own, Nm."""
        p, level = self._physics, 0.0
        if "seal" in self._used:
            self._lip = np.clip(self._lip + self._step * speed, -p.seal_stroke, p.seal_stroke)
            level = level + p.seal * (1.0 - (self._lip / p.seal_stroke) ** 2)
        if "cover" in self._used:
            level = level + p.cover * np.clip((np.abs(speed) - p.cover_speed) / ONSET, 0.0, 1.0)
        return level

    def link_torque(self, q: np.ndarray) -> np.ndarray | float:
        """What resists on the links, Nm."""
        if "snap" not in self._used:
            return 0.0
        p = self._physics
        over = np.abs(q - p.snap_angle) > p.snap_width
        self._snapped = np.where(over, np.sign(q - p.snap_angle), self._snapped)
        return -p.snap * self._snapped

    def given(self, wanted: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """What drives give at a command of `wanted` Nm, gravity compensation included, at the rotors' speed."""
        p, used = self._physics, self._used
        if "notch" in used:
            wanted = self._filtered(wanted)
        if "crosstalk" in used:
            wanted = wanted + np.matmul(p.crosstalk, wanted[:, :, None])[:, :, 0]
        if "creep" in used:
            self._slow = wanted if self._slow is None else self._slow
            self._slow = self._slow + (1.0 - np.exp(-self._step / p.creep_time)) * (wanted - self._slow)
            wanted = wanted + p.creep * (wanted - self._slow)
        if "converter_step" in used:
            step = np.maximum(p.converter_step, 1e-9)
            wanted = np.where(p.converter_step > 0, np.round(wanted / step) * step, wanted)
        if "drive_play" in used:
            before = wanted if self._followed is None else self._followed
            wanted = self._followed = np.clip(before, wanted - p.drive_play, wanted + p.drive_play)
        if "lopsided" in used:
            wanted = wanted + p.lopsided * np.abs(wanted)
        if "sag" in used:
            drawn = np.maximum(wanted * speed, 0.0).sum(axis=1, keepdims=True)
            self._power = self._power + (1.0 - np.exp(-self._step / p.sag_time)) * (drawn - self._power)
            wanted = wanted * np.maximum(1.0 - p.sag * self._power / POWER, 0.3)
        return wanted

    def _filtered(self, wanted: np.ndarray) -> np.ndarray:
        """Less a share of what a band-pass, 2 z w s / (s^2 + 2 z w s + w^2), lets through: a notch."""
        p = self._physics
        natural = 2 * np.pi * p.notch_frequency
        if self._passed_sum is None:  # at rest
            self._passed_sum = 2 * SHALLOW / natural * wanted
        change = 2 * SHALLOW * natural * (wanted - self._passed) - natural**2 * self._passed_sum
        self._passed = self._passed + self._step * change
        self._passed_sum = self._passed_sum + self._step * self._passed
        return wanted - p.notch * self._passed


def measured_speed(physics: Physics, dq: np.ndarray) -> np.ndarray:
    """What tachometers (B, 7) with a wrong scale show at dq rad/s."""
    return dq * (1.0 + physics.tachometer)

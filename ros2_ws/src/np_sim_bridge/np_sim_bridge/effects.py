"""The part of a patch that is no number of the rigid-body model: drive, sensors, friction of odd shape.

Stepped once a physics step or control period, between the torque that was asked for and the joints. Effects
of the
controller (software) are not the backend's to carry: `ignored` names them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import mujoco
import numpy as np

from np_description.panda import NOMINAL
from np_description.patch import Patch

IGNORED = (
    "stiffness_gain_error",
    "damping_gain_error",
    "controller_mismatch",
    "joint_elasticity",
    "backlash",
    "transmission_hysteresis",
)
STICTION_SPEED = 0.005  # rad/s at which a friction that is an explicit torque has its full level
DRIFT_DURATION = 180.0  # s over which friction changes by the whole of `change`


class Gap:
    """What a patch does to commands, joints and measurements: of one simulation, or of S side by side.

    patch: one, and every array below is (7,); or a sequence of S, and they are (S, 7). period: s of a control
    period, in which `drive`, `extra` and `sense` are called once each; seed: of lost packets, the same ones
    in
    all simulations; begin: s for which the arms had been moving, a number or (S,).
    """

    def __init__(self, patch: Patch | Sequence[Patch], period: float, seed: int = 0, begin: float | np.ndarray = 0.0):
        patches = (patch,) if isinstance(patch, Patch) else tuple(patch)
        lead = () if isinstance(patch, Patch) else (len(patches),)

        def joint(effect: str, parameter: str) -> np.ndarray:
            return np.array([p.per_joint(effect, parameter) for p in patches]).reshape(*lead, 7)

        self._period, self._time = period, np.zeros(lead) + begin
        self._rng = np.random.default_rng(seed)
        self.ignored = tuple(sorted({e.effect for p in patches for e in p.effects if e.effect in IGNORED}))
        self._scale, self._offset = 1 + joint("torque_scale", "scale"), joint("torque_offset", "offset")
        self._lag = joint("actuator_lag", "time_constant")
        self._limit = _unlimited(joint("torque_saturation", "limit"))
        self._rate = _unlimited(joint("torque_rate_limit", "limit"))
        self._loss = joint("packet_loss", "share").max(axis=-1, keepdims=True)
        self._delay = np.maximum(joint("command_delay", "delay"), 0.0) / period
        self.late = np.maximum(joint("measurement_delay", "delay"), 0.0) / period
        self._commands: deque[np.ndarray] = deque(maxlen=int(self._delay.max()) + 2)
        self._measured: deque[np.ndarray] = deque(maxlen=int(self.late.max()) + 2)
        self.bias, self._step = joint("encoder_bias", "bias"), joint("encoder_quantisation", "step")
        self._gain, self._zero = 1 + joint("torque_sensor_error", "gain"), joint("torque_sensor_error", "offset")
        self._uneven_coulomb = 0.5 * (
            joint("asymmetric_coulomb_friction", "level_positive")
            - joint("asymmetric_coulomb_friction", "level_negative")
        )
        self._uneven_viscous = 0.5 * (
            joint("asymmetric_viscous_friction", "coefficient_positive")
            - joint("asymmetric_viscous_friction", "coefficient_negative")
        )
        self._breakaway = joint("stribeck_friction", "breakaway")
        self._stribeck = np.maximum(joint("stribeck_friction", "speed"), 1e-3)
        self._by_load = joint("load_dependent_friction", "coefficient")
        self._late_level = joint("presliding_friction", "level")
        self._stroke = np.maximum(joint("presliding_friction", "stroke"), 1e-4)
        self._bristle, self._last = np.zeros((*lead, 7)), None
        self._spring, self._pull = joint("cable_torque", "stiffness"), joint("cable_torque", "offset")
        self._sine, self._cosine = joint("torque_ripple", "sine"), joint("torque_ripple", "cosine")
        self._order, self._drift = joint("torque_ripple", "order"), joint("thermal_drift", "change")
        lasting = joint("thermal_drift", "duration")
        self._duration = np.where(lasting > 0, lasting, DRIFT_DURATION)
        self._through: np.ndarray | None = None
        self._rated: np.ndarray | None = None
        self._gravity = [_Gravity(p) if _touches_gravity(p) else None for p in patches]
        self._load = _Gravity(Patch()) if self._by_load.any() else None

    def drive(self, torque: np.ndarray) -> np.ndarray:
        """What the drives give, Nm, gravity apart, in the period in which `torque` Nm is commanded."""
        torque = np.array(torque, dtype=float)
        if self._commands and self._loss.any():
            torque = np.where(self._rng.random() < self._loss, self._commands[-1], torque)
        self._commands.append(torque)
        wanted = _delayed(self._commands, self._delay)
        if self._rated is not None:
            step = self._rate * self._period
            wanted = np.clip(wanted, self._rated - step, self._rated + step)
        self._rated = wanted
        wanted = np.clip(wanted, -self._limit, self._limit)
        if self._through is None:
            self._through = wanted
        decay = np.where(self._lag > 0, np.exp(-self._period / np.maximum(self._lag, 1e-9)), 0.0)
        self._through = wanted + (self._through - wanted) * decay
        return self._scale * self._through + self._offset

    def extra(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque Nm on the joints that nothing else accounts for, at q rad, dq rad/s."""
        self._time = self._time + self._period
        direction = np.tanh(dq / STICTION_SPEED)
        torque = -self._uneven_coulomb * np.abs(direction) - self._uneven_viscous * np.abs(dq)
        torque -= self._breakaway * direction * np.exp(-((dq / self._stribeck) ** 2))
        torque -= self._spring * (q - NOMINAL.ready) + self._pull
        torque -= self._sine * np.sin(self._order * q) + self._cosine * np.cos(self._order * q)
        nominal = NOMINAL.frictionloss * direction + NOMINAL.damping * dq
        torque -= self._drift * np.minimum(self._time[..., None] / self._duration, 1.0) * nominal
        moved = q - (q if self._last is None else self._last)
        self._last = q.copy()
        self._bristle = np.sign(moved) + (self._bristle - np.sign(moved)) * np.exp(-np.abs(moved) / self._stroke)
        torque -= self._late_level * self._bristle
        if self._load is not None:
            held = np.array([self._load.nominal(row) for row in q.reshape(-1, 7)]).reshape(q.shape)
            torque -= self._by_load * np.abs(held) * direction
        for gravity, row, angles in zip(self._gravity, torque.reshape(-1, 7), q.reshape(-1, 7)):
            if gravity is not None:
                row += gravity.left(angles)
        return torque

    def sense(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the sensors say of joint angle, speed and torque."""
        self._measured.append(np.array([q, dq], dtype=float))
        angle, speed = _delayed(self._measured, np.broadcast_to(self.late, self._measured[-1].shape))
        angle = angle + self.bias
        coarse = self._step > 0
        angle = np.where(coarse, np.round(angle / np.where(coarse, self._step, 1.0)) * self._step, angle)
        return angle, speed, self._gain * torque + self._zero


def _delayed(past: Sequence[np.ndarray], periods: np.ndarray) -> np.ndarray:
    """What was `periods` before the newest, linear in between; the oldest where nothing is known."""
    rows, last = np.array(past), len(past) - 1
    whole = np.floor(periods).astype(int)
    share = periods - whole
    newer, older = (np.take_along_axis(rows, np.maximum(last - whole - k, 0)[None], axis=0)[0] for k in (0, 1))
    return (1 - share) * newer + share * older


class _Gravity:
    """Gravity of the patched arm against what the nominal one compensates."""

    def __init__(self, patch: Patch):
        from np_description.domains import CARD
        from np_description.scene import load_model

        self._nominal, self._real = load_model(CARD), load_model(CARD, panda=patch.panda())
        for roll, pitch in [(e.get("roll"), e.get("pitch")) for e in patch.of("base_tilt")]:
            size = -self._real.opt.gravity[2]
            self._real.opt.gravity[:] = [size * pitch, -size * roll, -size]
        self._data = [mujoco.MjData(m) for m in (self._nominal, self._real)]
        self._share = 1 + float(
            patch.per_joint("gravity_compensation_error", "scale").max(initial=0.0)
            + patch.per_joint("gravity_compensation_error", "scale").min(initial=0.0)
        )
        self._bias = patch.per_joint("encoder_bias", "bias")

    def nominal(self, q: np.ndarray) -> np.ndarray:
        """Torque (7,) Nm that holds the nominal arm."""
        return self._holding(0, q)

    def left(self, q: np.ndarray) -> np.ndarray:
        """Torque (7,) Nm that is left on the joints, compensation minus weight."""
        return self._share * self._holding(0, q + self._bias) - self._holding(1, q)

    def _holding(self, which: int, q: np.ndarray) -> np.ndarray:
        model, data = (self._nominal, self._real)[which], self._data[which]
        data.qpos[:7], data.qvel[:] = q, 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        result = np.empty(model.nv)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, result)
        return result[:7]


def _unlimited(limit: np.ndarray) -> np.ndarray:
    return np.where(limit > 0, limit, np.inf)


def _touches_gravity(patch: Patch) -> bool:
    return any(
        e.effect in ("payload", "link_com", "gravity_compensation_error", "base_tilt", "encoder_bias")
        for e in patch.effects
    )

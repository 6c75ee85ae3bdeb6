"""The part of a patch that is no number of the rigid-body model: drive, sensors, friction of odd shape.

Stepped once a physics step or control period, between the torque that was asked for and the joints. Effects of the
controller (software) are not the backend's to carry: `ignored` names them.
"""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from np_description.panda import NOMINAL
from np_description.patch import Patch

IGNORED = ("stiffness_gain_error", "damping_gain_error", "controller_mismatch", "joint_elasticity", "backlash",
           "transmission_hysteresis")
STICTION_SPEED = 0.005  # rad/s at which a friction that is an explicit torque has its full level
DRIFT_DURATION = 180.0  # s over which friction changes by the whole of `change`


class Gap:
    """What a patch does to commands, joints and measurements; one instance a simulation.

    period: s of a control period, in which `drive`, `extra` and `sense` are called once each; seed: of lost packets.
    """

    def __init__(self, patch: Patch, period: float, seed: int = 0):
        self._period, self._time = period, 0.0
        self._rng = np.random.default_rng(seed)
        joint = patch.per_joint
        self.ignored = tuple(e.effect for e in patch.effects if e.effect in IGNORED)
        self._scale, self._offset = 1 + joint("torque_scale", "scale"), joint("torque_offset", "offset")
        self._lag = joint("actuator_lag", "time_constant")
        self._limit = _unlimited(joint("torque_saturation", "limit"))
        self._rate = _unlimited(joint("torque_rate_limit", "limit"))
        self._loss = float(joint("packet_loss", "share").max())
        delay = joint("command_delay", "delay") / period
        self._delay = delay
        self._commands: deque[np.ndarray] = deque(maxlen=int(delay.max()) + 2)
        self._measured: deque[tuple[np.ndarray, np.ndarray]] = deque(
            maxlen=int(joint("measurement_delay", "delay").max() / period) + 2)
        self._late = float(joint("measurement_delay", "delay").max() / period)
        self.bias, self._step = joint("encoder_bias", "bias"), joint("encoder_quantisation", "step")
        self._gain, self._zero = 1 + joint("torque_sensor_error", "gain"), joint("torque_sensor_error", "offset")
        self._uneven_coulomb = 0.5 * (joint("asymmetric_coulomb_friction", "level_positive")
                                      - joint("asymmetric_coulomb_friction", "level_negative"))
        self._uneven_viscous = 0.5 * (joint("asymmetric_viscous_friction", "coefficient_positive")
                                      - joint("asymmetric_viscous_friction", "coefficient_negative"))
        self._breakaway = joint("stribeck_friction", "breakaway")
        self._stribeck = np.maximum(joint("stribeck_friction", "speed"), 1e-3)
        self._by_load = joint("load_dependent_friction", "coefficient")
        self._late_level = joint("presliding_friction", "level")
        self._stroke = np.maximum(joint("presliding_friction", "stroke"), 1e-4)
        self._bristle, self._last = np.zeros(7), None
        self._spring = joint("cable_torque", "stiffness")
        self._sine, self._cosine = joint("torque_ripple", "sine"), joint("torque_ripple", "cosine")
        self._order, self._drift = joint("torque_ripple", "order"), joint("thermal_drift", "change")
        self._through: np.ndarray | None = None
        self._rated: np.ndarray | None = None
        self._gravity = _Gravity(patch) if _touches_gravity(patch) else None
        self._load = _Gravity(Patch()) if self._by_load.any() else None

    def drive(self, torque: np.ndarray) -> np.ndarray:
        """What the drives give (7,) Nm, gravity apart, in the period in which `torque` (7,) Nm is commanded."""
        lost = self._commands and self._rng.random() < self._loss
        self._commands.append(self._commands[-1] if lost else np.array(torque, dtype=float))
        whole = np.floor(self._delay).astype(int)
        last = len(self._commands) - 1
        at = np.maximum(last - whole, 0)
        before = np.maximum(at - 1, 0)
        share = self._delay - whole
        rows = np.array(self._commands)
        wanted = (1 - share) * rows[at, range(7)] + share * rows[before, range(7)]
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
        """Torque (7,) Nm on the joints that nothing else accounts for, at q (7,) rad, dq (7,) rad/s."""
        self._time += self._period
        direction = np.tanh(dq / STICTION_SPEED)
        torque = -self._uneven_coulomb * np.abs(direction) - self._uneven_viscous * np.abs(dq)
        torque -= self._breakaway * direction * np.exp(-((dq / self._stribeck) ** 2))
        torque -= self._spring * (q - NOMINAL.ready)
        torque -= self._sine * np.sin(self._order * q) + self._cosine * np.cos(self._order * q)
        nominal = NOMINAL.frictionloss * direction + NOMINAL.damping * dq
        torque -= self._drift * min(self._time / DRIFT_DURATION, 1.0) * nominal
        moved = q - (q if self._last is None else self._last)
        self._last = q.copy()
        self._bristle = np.sign(moved) + (self._bristle - np.sign(moved)) * np.exp(-np.abs(moved) / self._stroke)
        torque -= self._late_level * self._bristle
        if self._load is not None:
            torque -= self._by_load * np.abs(self._load.nominal(q)) * direction
        if self._gravity is not None:
            torque += self._gravity.left(q)
        return torque

    def sense(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the sensors say of joint angle, speed and torque."""
        self._measured.append((np.array(q), np.array(dq)))
        states = list(self._measured)
        whole = int(self._late)
        newer, older = states[max(0, len(states) - 1 - whole)], states[max(0, len(states) - 2 - whole)]
        share = self._late - whole
        angle, speed = ((1 - share) * a + share * b for a, b in zip(newer, older))
        angle = angle + self.bias
        coarse = self._step > 0
        angle = np.where(coarse, np.round(angle / np.where(coarse, self._step, 1.0)) * self._step, angle)
        return angle, speed, self._gain * torque + self._zero


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
        self._share = 1 + float(patch.per_joint("gravity_compensation_error", "scale").max(initial=0.0)
                                + patch.per_joint("gravity_compensation_error", "scale").min(initial=0.0))
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
    return any(e.effect in ("payload", "link_com", "gravity_compensation_error", "base_tilt", "encoder_bias")
               for e in patch.effects)

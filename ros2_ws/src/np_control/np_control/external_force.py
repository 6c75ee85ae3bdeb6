"""The external force as the robot estimates it: from joint torques and its own model, never from a contact solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from np_control.dynamics import Dynamics
from np_description.force_reflex import FORCE_REFLEX, external_torque, filter_step, hand_wrench, threshold_share
from np_description.panda import NOMINAL, PandaModel

STICTION_SPEED = 0.01  # rad/s, below which Coulomb friction is in proportion: at rest it cannot be measured


@dataclass(frozen=True)
class ExternalForce:
    """Estimate of one control period."""

    torque: np.ndarray
    """Filtered external torque (7,) Nm on the joints."""
    wrench: np.ndarray
    """Filtered external wrench (6,) N, Nm on the hand: about T_E, base axes."""
    raw: np.ndarray
    """The same wrench before the filter."""
    share: float
    """Largest share of a threshold of the force reflex, of the filtered values."""


NO_FORCE = ExternalForce(np.zeros(7), np.zeros(6), np.zeros(6), 0.0)


class ForceObserver:
    """Estimates the external force on one arm, period by period.

    The model of links and payload is the nominal one, as the robot's own is. A Franka's torque sensors sit behind the gear, where
    friction and rotor do not show; a simulated drive's torque has both, so they are taken off with the numbers of `panda`, the
    arm that is simulated. A payload or a tilt that is not in the model counts as external force, as on the robot.
    """

    def __init__(self, period: float, panda: PandaModel = NOMINAL):
        """period: s of a control period."""
        drives = {name: getattr(panda, name) for name in ("frictionloss", "damping", "armature")}
        self._panda = replace(NOMINAL, **drives)
        self._dynamics = Dynamics(self._panda)
        self._period = period
        self.last = NO_FORCE

    def reset(self) -> None:
        """The arm stands somewhere new, at rest and free."""
        self.last = NO_FORCE

    def update(self, q: np.ndarray, dq: np.ndarray, dq_after: np.ndarray, torque: np.ndarray) -> ExternalForce:
        """The estimate after a period that began at q (7,) rad, dq (7,) rad/s and ended with dq_after (7,) rad/s.

        torque (7,) Nm: mean of the drives' torque in the period, without gravity. Values that are not finite give no estimate
        (its share is NaN), and the filter begins anew in the next period: it would keep them for ever.
        """
        before = self.last if isfinite(self.last.share) else NO_FORCE
        model = self._dynamics.feedforward(q, dq, (dq_after - dq) / self._period) + self._friction(dq_after)
        raw_torque = external_torque(torque, model)
        raw = hand_wrench(raw_torque, self._dynamics.jacobian(q))
        filtered = filter_step(before.torque, raw_torque, self._period)
        wrench = filter_step(before.wrench, raw, self._period)
        self.last = ExternalForce(filtered, wrench, raw, float(threshold_share(filtered, wrench, FORCE_REFLEX)))
        return self.last

    def _friction(self, dq: np.ndarray) -> np.ndarray:
        arm = self._panda
        sliding = np.minimum(np.maximum(dq / STICTION_SPEED, -1.0), 1.0)  # half of numpy.clip's time, at 500 Hz
        return arm.damping * dq + arm.frictionloss * sliding

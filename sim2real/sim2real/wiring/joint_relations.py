"""What signals of joints have to do with each other, and by how much a recording contradicts it.

Each relation gives every joint a number from 0 (it holds) to 1 (the signals have nothing to do with each other):

- `limits`: measured positions lie between the joint's limits;
- `speed`: the slope of the position is the velocity;
- `tracking`: the position follows its target;
- `law`: the command beyond its feedforward is K (q_d - q) + D (dq_d - dq) (`np_control.impedance`);
- `drive`: the measured effort is the commanded torque;
- `dynamics`: the effort is rigid-body torque (Featherstone 2008, 5.3), weight of a load, friction, inertia of a rotor, and an offset.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from sim2real.arm.model import Arm
from sim2real.arm.rigid_body import feedforward_torque, inverse_dynamics
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.joint_signals import JointSignals

WIRING = THRESHOLDS.wiring
SPEED_FLOOR = np.array(WIRING.speed_floor)
SLIDE = 0.005  # rad/s, of the smooth step of friction


class JointRelations:
    """The relations of one arm's signals. What a candidate leaves as it is is not computed again."""

    def __init__(self, arm: Arm, with_gravity: bool):
        """with_gravity: whether the effort includes what holds the arm."""
        self.without_gravity = not with_gravity
        self._arm, self._gravity = arm, None if with_gravity else np.zeros(3)
        self._floor = WIRING.torque_floor * arm.torque_limit
        last = np.arange(len(arm)) == len(arm) - 1
        self._load = replace(arm, mass=1.0 * last, moment=np.outer(last, arm.tip), inertia=0.0 * arm.inertia)
        self._made: dict[tuple, tuple[np.ndarray, tuple]] = {}

    def contradictions(self, s: JointSignals) -> dict[str, np.ndarray]:
        """By relation, its contradiction (k,) of each joint."""
        once = self._once
        rigid = once(self._rigid, s.position, s.velocity, s.acceleration)
        load = once(self._weigh_load, s.position)
        found = {
            "limits": once(self._beyond_limits, s.position),
            "speed": once(_difference, s.speed, s.velocity, SPEED_FLOOR),
            "dynamics": once(self._unexplained, s.effort, rigid, load, s.velocity, s.acceleration),
        }
        if s.command is not None:
            found["tracking"] = once(_distance, s.position, s.target)
            found["drive"] = once(_difference, s.effort, s.command, self._floor)
        if s.stiffness is not None:
            fed = once(self._feedforward, s.position, s.velocity, s.target_acceleration)
            law = once(feedback_torque, s.position, s.velocity, s.target, s.target_velocity, s.stiffness, s.damping)
            found["law"] = once(_difference, law, once(np.subtract, s.command, fed), self._floor)
        return found

    def weight(self, position: np.ndarray) -> np.ndarray:
        """Torque (n, k) Nm that holds the arm's weight at positions (n, k) rad."""
        return inverse_dynamics(self._arm, position)

    def _once(self, function, *arrays: np.ndarray) -> np.ndarray:
        key = (function.__name__, *map(id, arrays))
        if key not in self._made:  # the arrays are kept too, so that no other has their identity
            self._made[key] = function(*arrays), arrays
        return self._made[key][0]

    def _rigid(self, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        return inverse_dynamics(self._arm, position, velocity, acceleration, self._gravity)

    def _weigh_load(self, position: np.ndarray) -> np.ndarray:
        """Torque (n, k) Nm that holds 1 kg at the tool point."""
        return inverse_dynamics(self._load, position)

    def _feedforward(self, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        return feedforward_torque(self._arm, position, velocity, acceleration)

    def _beyond_limits(self, position: np.ndarray) -> np.ndarray:
        """Share (k,) of moments beyond a joint's limits; of a joint without, beyond some turns."""
        arm, slack, turns = self._arm, WIRING.limit_slack, 2 * np.pi * WIRING.turns
        lower = np.where(np.isfinite(arm.position_lower), arm.position_lower - slack, -turns)
        upper = np.where(np.isfinite(arm.position_upper), arm.position_upper + slack, turns)
        return np.mean((position < lower) | (position > upper), axis=0)

    def _unexplained(self, effort, rigid, load, velocity, acceleration) -> np.ndarray:
        """Share (k,) of the effort's variance that body, load, friction and rotor do not explain, none with a negative factor."""
        columns = np.stack([rigid, load, np.tanh(velocity / SLIDE), velocity, acceleration])
        columns = columns - columns.mean(axis=1, keepdims=True)
        effort = effort - effort.mean(axis=0)
        found = np.zeros(len(self._arm))
        for j, floor in enumerate(self._floor):
            own = columns[:, :, j].T / np.maximum(np.linalg.norm(columns[:, :, j], axis=1), 1e-9)
            _, left = nnls(own, effort[:, j])
            found[j] = left**2 / (effort[:, j] @ effort[:, j] + len(effort) * floor**2)
        return found


def feedback_torque(position, velocity, target, target_velocity, stiffness, damping) -> np.ndarray:
    """Torque (n, k) Nm of the controller's law without its feedforward; damping (n, k) Nm s/rad, not the ratio."""
    return stiffness * (target - position) + damping * (target_velocity - velocity)


def _distance(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Mean square (k,) between position and target over how far they go."""
    spread = position.var(axis=0) + target.var(axis=0) + WIRING.tracking**2
    return np.minimum(np.mean((position - target) ** 2, axis=0) / spread, 1.0)


def _difference(one: np.ndarray, other: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Energy (k,) of the difference over that of both, which is 1 where they have nothing in common; what is below `floor` is no evidence."""
    square = np.mean((one - other) ** 2, axis=0)
    return np.minimum(square / (np.mean(one**2 + other**2, axis=0) + floor**2), 1.0)

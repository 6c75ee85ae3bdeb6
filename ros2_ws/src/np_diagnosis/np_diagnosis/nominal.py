"""The torque a measured motion should have taken in the nominal simulator, and how it depends on inertia."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from np_control.dynamics import build_model
from np_description.panda import NOMINAL, Inertial, PandaModel

from np_diagnosis.signals import Samples

STICTION_SPEED = 0.003  # rad/s at which the direction of motion becomes sure
STANDSTILL = 0.02  # rad/s up to which a joint counts as standing
PARAMETERS = 10  # of a link: m, m c (3), inertia about the joint (xx, xy, yy, xz, yz, zz), Pinocchio's order


def without_hand(panda: PandaModel = NOMINAL) -> PandaModel:
    """The arm with nothing on its flange."""
    nothing = Inertial(0.0, np.zeros(3), np.zeros(6))
    return replace(panda, inertials={**panda.inertials, "hand": nothing, "finger": nothing})


def rigid_body_only(panda: PandaModel = NOMINAL) -> PandaModel:
    """The arm without joint friction, damping and rotors, as a sensor after the gear might see it."""
    none = np.zeros(len(panda.joints))
    return replace(panda, frictionloss=none, damping=none, armature=none)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Nominal torques of samples, all (n, 7) Nm.

    gravity: holds the arm; inertial: accelerates it, Coriolis included, rotors not; rotors; friction. `total`
    is what the sensor should have shown (with gravity only if the sensor does); load: through the gear;
    direction (n, 7): that of motion, -1..1. regressor (n, 7, 70): change of torque with the inertial
    parameters
    of each link (`PARAMETERS` each);
    gravity_slope (n, 7, 7): change of joint i's gravity torque with position k.
    """

    gravity: np.ndarray
    inertial: np.ndarray
    rotors: np.ndarray
    friction: np.ndarray
    total: np.ndarray
    load: np.ndarray
    direction: np.ndarray
    regressor: np.ndarray
    gravity_slope: np.ndarray


def sign(velocity: np.ndarray) -> np.ndarray:
    """Direction of motion, smooth through standstill."""
    return np.tanh(velocity / STICTION_SPEED)


def predict(samples: Samples, panda: PandaModel = NOMINAL) -> Prediction:
    """Nominal torques of the samples' motion."""
    gravity, inertial, rotors = _torques(samples, panda)
    joints = samples.position.shape[1]
    direction = np.column_stack([samples.filtered(j, lambda q, v: sign(v)) for j in range(joints)])
    friction = direction * panda.frictionloss + samples.velocity * panda.damping
    model = build_model(panda)
    data = model.createData()
    regressor = np.empty((len(samples), joints, PARAMETERS * joints))
    slope = np.empty((len(samples), joints, joints))
    for i in range(len(samples)):
        q = samples.position[i]
        regressor[i] = pin.computeJointTorqueRegressor(
            model, data, q, samples.velocity[i], samples.acceleration[i]
        )
        slope[i] = pin.computeGeneralizedGravityDerivatives(model, data, q)
    total = inertial + rotors + friction + (gravity if samples.with_gravity else 0.0)
    return Prediction(
        gravity, inertial, rotors, friction, total, gravity + inertial, direction, regressor, slope
    )


def expected_torque(samples: Samples, panda: PandaModel = NOMINAL) -> np.ndarray:
    """What the sensors of the nominal arm would have shown (n, 7) Nm; near standstill only roughly."""
    gravity, inertial, rotors = _torques(samples, panda)
    friction = sign(samples.velocity) * panda.frictionloss + samples.velocity * panda.damping
    return inertial + rotors + friction + (gravity if samples.with_gravity else 0.0)


def _torques(samples: Samples, panda: PandaModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gravity, inertial and rotor torque, each (n, 7) Nm."""
    model = build_model(panda)
    model.armature[:] = 0.0
    data = model.createData()
    gravity, inertial = np.empty_like(samples.position), np.empty_like(samples.position)
    for i in range(len(samples)):
        q, v, a = samples.position[i], samples.velocity[i], samples.acceleration[i]
        gravity[i] = pin.computeGeneralizedGravity(model, data, q)
        inertial[i] = pin.rnea(model, data, q, v, a) - gravity[i]
    return gravity, inertial, samples.acceleration * panda.armature

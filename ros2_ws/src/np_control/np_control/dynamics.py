"""Rigid-body dynamics of the arm with Pinocchio, from the same numbers as every other model of it.

Hand and fingers are one body with the seventh link: the fingers weigh 15 g each and move seldom.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from np_description.panda import NOMINAL, TCP_FRAME, Frame, Inertial, PandaModel


def build_model(panda: PandaModel = NOMINAL, finger_opening: float = 0.0) -> pin.Model:
    """Pinocchio model of the seven joints, base fixed, gravity along -z.

    finger_opening: of each finger, m. Rotors are the model's armature; it has no joint friction.
    """
    model = pin.Model()
    parent = 0
    for i, name in enumerate(panda.joints):
        parent = model.addJoint(
            parent,
            pin.JointModelRZ(),
            _placement(panda.joint_frames[i]),
            name,
            panda.torque_limit[i : i + 1],
            panda.velocity_limit[i : i + 1],
            panda.position_lower[i : i + 1],
            panda.position_upper[i : i + 1],
        )
        model.appendBodyToJoint(parent, _inertia(panda.inertials[f"link{i + 1}"]), pin.SE3.Identity())
    hand = _placement(panda.frames["link7_hand"])
    model.appendBodyToJoint(parent, _inertia(panda.inertials["hand"]), hand)
    slide = pin.SE3(np.eye(3), np.array([0.0, finger_opening, 0.0]))
    for finger in ("hand_finger1", "hand_finger2"):
        placement = hand * _placement(panda.frames[finger]) * slide
        model.appendBodyToJoint(parent, _inertia(panda.inertials["finger"]), placement)
    placement = hand * _placement(panda.frames["hand_tcp"])
    # Without its inertia of nothing, which would still change the last bit of the last link's centre of mass.
    model.addFrame(pin.Frame(TCP_FRAME, parent, placement, pin.FrameType.OP_FRAME), False)
    model.armature = panda.armature.copy()
    return model


_LOWER = np.tril_indices(7, -1)


class Dynamics:
    """Dynamics at one state at a time; q (7,) rad, dq (7,) rad/s. Not for use by several threads."""

    def __init__(self, panda: PandaModel = NOMINAL, finger_opening: float = 0.0):
        self._model = build_model(panda, finger_opening)
        self._weightless = self._model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        self._data = self._model.createData()
        self._weightless_data = self._weightless.createData()
        self._tcp = self._model.getFrameId(TCP_FRAME)

    def coriolis(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Coriolis and centrifugal torque C(q, dq) dq (7,) Nm, without gravity."""
        return pin.nonLinearEffects(self._weightless, self._weightless_data, q, dq).copy()

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Torque (7,) Nm that holds the arm against gravity."""
        return pin.computeGeneralizedGravity(self._model, self._data, q).copy()

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Inertia (7, 7) kg m^2, rotors included."""
        inertia = pin.crba(self._model, self._data, q).copy()
        inertia[_LOWER] = inertia.T[_LOWER]  # Pinocchio guarantees the upper half only
        return inertia

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Geometric Jacobian (6, 7) of T_E in base axes, linear rows first: `np_control.kinematics.jacobian`, ten times as fast."""
        return pin.computeFrameJacobian(self._model, self._data, q, self._tcp, pin.LOCAL_WORLD_ALIGNED)

    def feedforward(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque (7,) Nm for the acceleration ddq (7,) rad/s^2, without gravity: M(q) ddq + C(q, dq) dq."""
        return pin.rnea(self._weightless, self._weightless_data, q, dq, ddq).copy()


def _placement(frame: Frame) -> pin.SE3:
    w, x, y, z = frame.quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), frame.position)


def _inertia(inertial: Inertial) -> pin.Inertia:
    xx, yy, zz, xy, xz, yz = inertial.inertia
    return pin.Inertia(inertial.mass, inertial.com, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

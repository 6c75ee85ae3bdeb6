"""The nominal Franka Emika Panda: names, kinematics, inertia, limits, joint dynamics.

The numbers live in data/panda_nominal.yaml with their sources; every model of the arm (MJCF, Pinocchio, batched
kinematics, safety limits) is built from the one object `NOMINAL`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.resources import files

import numpy as np
import yaml


@dataclass(frozen=True)
class Frame:
    """A fixed transform, parent to child."""

    position: np.ndarray
    """(3,) m."""
    quaternion: np.ndarray
    """wxyz (4,)."""


@dataclass(frozen=True)
class Inertial:
    """The inertial parameters of a link."""

    mass: float
    """kg."""
    com: np.ndarray
    """Centre of mass in the link frame (3,) m."""
    inertia: np.ndarray
    """ixx iyy izz ixy ixz iyz about the centre of mass, kg m^2."""


@dataclass(frozen=True, eq=False)  # compared and hashed by identity: arrays have no truth value
class PandaModel:
    """The arm; arrays have one entry a joint, base to wrist."""

    joints: tuple[str, ...]
    """Names of the arm's joints."""
    fingers: tuple[str, ...]
    """Names of the finger joints."""
    position_lower: np.ndarray
    """rad."""
    position_upper: np.ndarray
    """rad."""
    velocity_limit: np.ndarray
    """rad/s."""
    torque_limit: np.ndarray
    """Nm."""
    torque_rate_limit: float
    """Nm/s."""
    ready: np.ndarray
    """Ready posture, rad."""
    frictionloss: np.ndarray
    """Coulomb friction, Nm."""
    damping: np.ndarray
    """Viscous friction, Nm s/rad."""
    armature: np.ndarray
    """Rotor inertia at the joint, kg m^2."""
    frames: dict[str, Frame] = field(repr=False)
    """Fixed transform of each link to its parent, by name."""
    inertials: dict[str, Inertial] = field(repr=False)
    """By link."""

    @property
    def joint_frames(self) -> list[Frame]:
        """The seven transforms link(i-1) -> link(i), in order."""
        return [self.frames[f"link{i}_link{i + 1}"] for i in range(7)]


def load_panda(text: str) -> PandaModel:
    """A PandaModel from the text of a YAML file in the form of data/panda_nominal.yaml.

    Raises KeyError for a missing entry and ValueError where a list has not one number a joint.
    """
    raw = yaml.safe_load(text)

    def per_joint(values, name):
        array = np.asarray(values, dtype=float)
        if array.shape != (7,) or not np.isfinite(array).all():
            raise ValueError(f"{name}: expected 7 finite numbers, got {values}")
        array.setflags(write=False)
        return array

    top = {
        name: per_joint(raw[name], name)
        for name in ("position_lower", "position_upper", "velocity_limit", "torque_limit", "ready")
    }
    dynamics = {name: per_joint(raw["joint_dynamics"][name], name) for name in ("frictionloss", "damping", "armature")}
    return PandaModel(
        joints=tuple(raw["joints"]),
        fingers=tuple(raw["fingers"]),
        torque_rate_limit=float(raw["torque_rate_limit"]),
        frames={
            name: Frame(np.asarray(f["pos"], float), np.asarray(f["quat"], float)) for name, f in raw["frames"].items()
        },
        inertials={
            name: Inertial(float(i["mass"]), np.asarray(i["com"], float), np.asarray(i["inertia"], float))
            for name, i in raw["inertials"].items()
        },
        **top,
        **dynamics,
    )


NOMINAL = load_panda((files("np_description") / "data" / "panda_nominal.yaml").read_text())
JOINT_NAMES = NOMINAL.joints
STATE_NAMES = NOMINAL.joints + NOMINAL.fingers
PANDA = "panda"  # name of the arm, which effects and reports state
BASE_FRAME = "panda_link0"
TCP_FRAME = "panda_tcp"
FINGER_MAX = 0.04  # m, opening of one finger (datasheet: 80 mm between both)
FINGER_SPEED = 0.05  # m/s of one finger, at most (Franka Hand product manual)
FINGER_FORCE = 70.0  # N of one finger, continuous (datasheet)

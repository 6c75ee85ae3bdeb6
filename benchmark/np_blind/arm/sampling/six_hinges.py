"""The arm of six hinges that is not a Panda: what it is, its faults and how large they are, all from data/six_hinges.xml.

A controller of its own commands its drives, so that a recording has joints and torque only (`t_s`, `q_rad`, `dq_rad_s`,
`tau_J_Nm` with gravity, 500 Hz): it has the effects that these four show, and no others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from np_blind.arm.plant.physics import Physics
from np_blind.arm.plant.rigid_arm import HingedArm, Inertials, gravity_of
from np_blind.arm.sampling.faults import ARM, Fault, Parameters, give_effect
from np_description.panda import Frame

MODEL = Path(str(files("np_blind") / "data" / "six_hinges.xml"))
READY = np.array([0.2, -1.3, 1.5, -1.7, -1.4, 0.3])
TORQUE_NOISE = np.array([0.09, 0.09, 0.09, 0.036, 0.036, 0.027])  # Nm: three times a Panda's, for the drives are larger
HAND = np.array([0.05, 0.05, 0.07])  # m about the tool in which a payload may be

_TORQUE = (0.18, 0.18, 0.15, 0.06, 0.06, 0.045)
_SPEED = (0.24, 0.24, 0.21, 0.09, 0.09, 0.06)
_ALL = (0, 1, 2, 3, 4, 5)
LIMITS: dict[str, tuple[tuple[float, ...] | float, tuple[int, ...]]] = {
    "coulomb_friction": (_TORQUE, _ALL),
    "asymmetric_coulomb_friction": (_TORQUE, _ALL),
    "viscous_friction": (_SPEED, _ALL),
    "asymmetric_viscous_friction": (_SPEED, _ALL),
    "stribeck_friction": (_SPEED, _ALL),
    "presliding_friction": ((0.27, 0.27, 0.24, 0.09, 0.09, 0.06), _ALL),
    "torque_offset": (_TORQUE, _ALL),
    "torque_ripple": (_TORQUE, _ALL),
    "cable_torque": ((0.24, 0.18, 0.18, 0.09, 0.09, 0.06), _ALL),
    "armature": ((0.09, 0.09, 0.09, 0.03, 0.03, 0.024), _ALL),
    "link_com": ((0.0, 0.03, 0.03, 0.018, 0.015, 0.0), (1, 2, 3, 4)),
    "encoder_bias": ((0.0, 0.0045, 0.006, 0.0, 0.0, 0.0), (1, 2)),
    "payload": (0.12, ()),
    "base_tilt": (0.0045, ()),
}
"""By effect: size 1, three times a Panda's as the noise is, and the joints where it shows; none: of the arm."""
EFFECTS = tuple(LIMITS)
LARGEST = {"stribeck_friction": 6.0}  # times the limit; others 10


@dataclass(frozen=True)
class SixFault(Fault):
    """A fault of this arm: joints 0..5."""

    @property
    def component(self) -> str:
        """The joint's name, or "arm"."""
        return ARM if self.joint is None else joint_names()[self.joint]


def limit_of(fault: Fault) -> float:
    """Magnitude of size 1."""
    limit, _ = LIMITS[fault.effect]
    return limit if fault.joint is None else limit[fault.joint]


def largest(effect: str) -> float:
    """Times its limit, up to which an effect is drawn."""
    return LARGEST.get(effect, 10.0)


def _numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


@cache
def _bodies() -> tuple[ElementTree.Element, ...]:
    return tuple(ElementTree.parse(MODEL).getroot().iter("body"))


def joint_names() -> tuple[str, ...]:
    """Base to wrist."""
    return tuple(body.find("joint").get("name") for body in _bodies())


def _of_joints(name: str) -> np.ndarray:
    return np.array([float(body.find("joint").get(name)) for body in _bodies()])


@cache
def chain() -> HingedArm:
    """The arm as it should be."""
    frames = tuple(Frame(_numbers(body.get("pos")), _numbers(body.get("quat"))) for body in _bodies())
    bodies = [body.find("inertial") for body in _bodies()]
    mass = np.array([float(body.get("mass")) for body in bodies])
    com = np.array([_numbers(body.get("pos")) for body in bodies])
    inertia = np.array([np.diag(_numbers(body.get("diaginertia"))) for body in bodies])
    return HingedArm(frames, _of_joints("armature"), Inertials(mass[None], com[None], inertia[None], gravity_of(1)))


def nominal_physics(arms: int) -> Physics:
    """The arm as it should be, `arms` times."""
    own = chain()
    friction, damping = (np.tile(_of_joints(name), (arms, 1)) for name in ("frictionloss", "damping"))
    return Physics(
        own.inertials(arms),
        own.inertials(arms),
        armature=np.tile(own.armature, (arms, 1)),
        coulomb_forward=friction.copy(),
        coulomb_backward=friction,
        viscous_forward=damping.copy(),
        viscous_backward=damping,
    )


def give(physics: Physics, arm: int, fault: Fault, rng: np.random.Generator) -> Parameters:
    """Give an arm the fault; what exactly it got. A payload is anywhere on the hand, as in all sets with a wide background."""
    magnitude, joint = fault.size * limit_of(fault), fault.joint
    if fault.effect == "payload":
        tool = _numbers(next(_bodies()[-1].iter("site")).get("pos"))
        physics.inertials.add_point(arm, len(READY) - 1, magnitude, tool + rng.uniform(-1.0, 1.0, 3) * HAND)
        return {"mass": (magnitude, "kg")}
    if fault.effect == "cable_torque":
        physics.cable_stiffness[arm, joint] = magnitude
        physics.cable_centre[arm, joint] = READY[joint] + rng.uniform(-0.4, 0.4)
        return {"stiffness": (magnitude, "Nm/rad")}
    return give_effect(fault.effect, physics, arm, joint, magnitude, rng)

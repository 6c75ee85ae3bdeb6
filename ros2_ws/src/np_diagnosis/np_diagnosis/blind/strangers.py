"""Faults that no catalogue has: physically reasonable, and not to be called by any name of it."""

from __future__ import annotations

import numpy as np

from np_diagnosis.blind.faults import Fault, Parameters
from np_diagnosis.blind.plant import Physics
from np_diagnosis.excitation import READY, SECOND, THIRD

SCALE = np.array([0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015])  # Nm of size 1

FURTHEST = 0.2 + np.abs([SECOND - READY, THIRD - READY]).max(axis=0)  # rad from the ready posture


def _rub(p: Physics, i: int, j: int, size: float, rng: np.random.Generator) -> Parameters:
    """Something rubs at one angle: friction in a window of a few degrees."""
    angle = READY[j] + rng.uniform(-0.12, 0.12)
    p.rub[i, j], p.rub_angle[i, j], p.rub_width[i, j] = 3.0 * size, angle, rng.uniform(0.03, 0.07)
    return {"friction": (3.0 * size, "Nm"), "angle": (angle, "rad")}


def _wavy(p, i, j, size, rng):
    """A bent shaft: friction that goes up and down with the joint's angle."""
    p.wavy[i, j], p.wavy_order[i, j] = size, rng.uniform(6.0, 15.0)
    p.wavy_phase[i, j] = rng.uniform(0, 2 * np.pi)
    p.coulomb_forward[i, j] = max(p.coulomb_forward[i, j] - size, 0.03)  # the mean stays about what it was
    p.coulomb_backward[i, j] = p.coulomb_forward[i, j]
    return {"friction": (size, "Nm"), "order": (p.wavy_order[i, j], "1/rad")}


def _hardening(p, i, j, size, rng):
    """A bundle of hoses: a spring that hardens with the cube of the deflection."""
    p.cubic[i, j] = 8.0 * size / FURTHEST[j] ** 3
    return {"stiffness": (p.cubic[i, j], "Nm/rad^3")}


def _shake(p, i, j, size, rng):
    """A machine on the same table: a torque that swings at a frequency of its own."""
    p.shake[i, j], p.shake_frequency[i, j] = 1.5 * size, rng.uniform(1.5, 7.0)
    p.shake_phase[i, j] = rng.uniform(0, 2 * np.pi)
    return {"torque": (1.5 * size, "Nm"), "frequency": (p.shake_frequency[i, j], "Hz")}


def _ageing(p, i, j, size, rng):
    """Grease that sets: friction that grows while the joint rests, and is gone once it moves."""
    p.ageing[i, j], p.ageing_time[i, j] = 2.5 * size, rng.uniform(0.5, 1.5)
    return {"friction": (2.5 * size, "Nm"), "time": (p.ageing_time[i, j], "s")}


def _flutter(p, i, j, size, rng):
    """A worn power supply: the drive's torque scale swings in time."""
    load = np.array([3.0, 20.0, 8.0, 16.0, 1.0, 2.0, 0.4])[j]
    p.flutter[i, j], p.flutter_frequency[i, j] = min(1.5 * size / load, 0.4), rng.uniform(0.8, 3.0)
    return {"share": (p.flutter[i, j], "1"), "frequency": (p.flutter_frequency[i, j], "Hz")}


def _dropout(p, i, j, size, rng):
    """A loose contact: the drive loses part of its torque for 60 ms, at random."""
    load = np.array([3.0, 20.0, 8.0, 16.0, 1.0, 2.0, 0.4])[j]
    p.dropout[i, j] = min(3.0 * size / load, 0.6)
    return {"share": (p.dropout[i, j], "1")}


def _coupling(p, i, j, size, rng):
    """A cable over two joints: motion of a neighbour drags on this one."""
    other = j - 1 if j else 1
    p.coupling[i, j, other] = size / 0.3 * rng.choice([-1.0, 1.0])
    return {"drag": (p.coupling[i, j, other], "Nms/rad"), "other_joint": (other + 1.0, "1")}


STRANGERS = {
    "rub": (_rub, (0, 1, 2, 3, 4, 5, 6)),
    "wavy_friction": (_wavy, (0, 1, 2, 3, 4, 5, 6)),
    "hardening_spring": (_hardening, (0, 1, 2, 3, 4, 5, 6)),
    "shaking": (_shake, (0, 1, 2, 3, 4, 5, 6)),
    "ageing_friction": (_ageing, (0, 1, 2, 3, 4, 5, 6)),
    "drive_flutter": (_flutter, (1, 2, 3, 5)),
    "drive_dropout": (_dropout, (1, 2, 3, 5)),
    "joint_coupling": (_coupling, (1, 2, 3, 4, 5, 6)),
}
"""By name: what gives an arm the fault, and the joints (0..6) where it is drawn."""


def apply_stranger(physics: Physics, arm: int, fault: Fault, rng: np.random.Generator) -> Parameters:
    """Give an arm the stranger that the fault names; what exactly it got."""
    function, _ = STRANGERS[fault.effect]
    return function(physics, arm, fault.joint, fault.size * SCALE[fault.joint], rng)

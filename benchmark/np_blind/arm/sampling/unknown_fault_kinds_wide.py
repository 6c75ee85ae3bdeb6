"""Faults that no catalogue has, by an author who knew the catalogue, not the diagnosis.

Each function gives joint j of arm i the fault; size: Nm, about what it does to the joint's torque, so that size is comparable
among kinds.
"""

from __future__ import annotations

import numpy as np
from sim2real.excitation.suite import READY

from np_blind.arm.plant.physics import Physics
from np_blind.arm.sampling.faults import Parameters, draw_sign
from np_blind.arm.sampling.unknown_fault_kinds import LOAD
from np_control.impedance import STIFFNESS_MAX
from np_description.panda import NOMINAL

SPEED = 0.3  # rad/s, of a joint in motion
SWING = np.array([2.2, 1.9, 2.1, 1.3, 0.6, 0.4, 0.3])  # Nm, RMS of the suite's commanded torque without gravity
DAMPING = 2.0 * np.sqrt(STIFFNESS_MAX)  # Nms/rad, of the controller


def _neighbour(j: int, rng: np.random.Generator) -> int:
    return int(rng.choice([k for k in (j - 1, j + 1) if 0 <= k < len(READY)]))


def _snap(p: Physics, i: int, j: int, size: float, rng: np.random.Generator) -> Parameters:
    """A stiff cable that is bent through: it pushes to one side, and from some angle on snaps over to the other."""
    p.snap[i, j], p.snap_angle[i, j] = 1.5 * size, READY[j] + rng.uniform(-0.1, 0.1)
    p.snap_width[i, j] = rng.uniform(0.02, 0.06)
    return {"torque": (1.5 * size, "Nm"), "angle": (p.snap_angle[i, j], "rad")}


def _lopsided(p, i, j, size, rng):
    """A half-bridge with one weak side: the drive gives more one way than the other."""
    p.lopsided[i, j] = draw_sign(rng) * min(1.5 * size / LOAD[j], 0.5)
    return {"share": (p.lopsided[i, j], "1")}


def _notch(p, i, j, size, rng):
    """A drive's notch filter set to the wrong frequency: commands near it are not given."""
    p.notch[i, j] = min(2.2 * size / SWING[j], 0.9)
    p.notch_frequency[i, j] = rng.uniform(1.5, 4.0)
    return {"depth": (p.notch[i, j], "1"), "frequency": (p.notch_frequency[i, j], "Hz")}


def _coupled_rotors(p, i, j, size, rng):
    """A gear that two joints share: the rotor of one turns with the other, whose motion it resists."""
    other = j - 1
    most = 0.8 * np.sqrt(NOMINAL.armature[j] * NOMINAL.armature[other])
    p.rotor_coupling[i, j, other] = p.rotor_coupling[i, other, j] = draw_sign(rng) * min(0.6 * size, most)
    return {"inertia": (p.rotor_coupling[i, j, other], "kg m^2"), "other_joint": (other + 1.0, "1")}


def _crosstalk(p, i, j, size, rng):
    """Wires side by side: a share of a neighbouring drive's command is given here too."""
    other = _neighbour(j, rng)
    p.crosstalk[i, j, other] = draw_sign(rng) * min(2.0 * size / LOAD[other], 0.4)
    return {"share": (p.crosstalk[i, j, other], "1"), "other_joint": (other + 1.0, "1")}


def _sticky_drive(p, i, j, size, rng):
    """Magnetic hysteresis: the torque follows the command with play, so many Nm behind either way."""
    p.drive_play[i, j] = size
    return {"torque": (size, "Nm")}


def _seal(p, i, j, size, rng):
    """A lip seal that folds over after each reversal: friction for some degrees, until it has flipped."""
    p.seal[i, j], p.seal_stroke[i, j] = 3.0 * size, rng.uniform(0.03, 0.08)
    return {"friction": (3.0 * size, "Nm"), "stroke": (2.0 * p.seal_stroke[i, j], "rad")}


def _sag(p, i, j, size, rng):
    """A drive at the end of a long supply line: it gives less while the whole arm draws power."""
    p.sag[i, j], p.sag_time[i, j] = min(1.5 * size / LOAD[j], 0.3), rng.uniform(0.05, 0.3)
    return {"share_at_10_W": (p.sag[i, j], "1"), "time": (p.sag_time[i, j], "s")}


def _creep(p, i, j, size, rng):
    """Strain gauges on glue that yields, inside the drive's own loop: changes are given in excess, which then wears off."""
    p.creep[i, j], p.creep_time[i, j] = min(size / SWING[j], 0.5), rng.uniform(0.15, 0.5)
    return {"share": (p.creep[i, j], "1"), "time": (p.creep_time[i, j], "s")}


def _converter(p, i, j, size, rng):
    """A converter that has lost its lowest bits: the drive gives torque in steps."""
    p.converter_step[i, j] = 3.0 * size
    return {"step": (3.0 * size, "Nm")}


def _tachometer(p, i, j, size, rng):
    """A speed that is shown too large or too small, though the angle is right."""
    p.tachometer[i, j] = draw_sign(rng) * 3.0 * size / (DAMPING[j] * SPEED)
    return {"share": (p.tachometer[i, j], "1")}


def _cover(p, i, j, size, rng):
    """A loose cover that is flung out and touches, but only beyond some speed."""
    p.cover[i, j], p.cover_speed[i, j] = 3.0 * size, rng.uniform(0.2, 0.4)
    return {"friction": (3.0 * size, "Nm"), "speed": (p.cover_speed[i, j], "rad/s")}


_ANY = (0, 1, 2, 3, 4, 5, 6)
_LOADED = (1, 2, 3, 5)
WIDE = {
    "snapping_cable": (_snap, _ANY),
    "lopsided_drive": (_lopsided, (0, 2, 4, 6)),  # where torque goes both ways
    "misplaced_notch": (_notch, _ANY),
    "coupled_rotors": (_coupled_rotors, (1, 2, 3, 4, 5, 6)),
    "drive_crosstalk": (_crosstalk, _ANY),
    "drive_hysteresis": (_sticky_drive, _ANY),
    "flipping_seal": (_seal, _ANY),
    "sagging_supply": (_sag, _LOADED),
    "creeping_gauges": (_creep, _LOADED),
    "coarse_converter": (_converter, _ANY),
    "tachometer_scale": (_tachometer, _ANY),
    "touching_cover": (_cover, _ANY),
}
"""By name: what gives an arm the fault, and the joints (0..6) where it is drawn."""

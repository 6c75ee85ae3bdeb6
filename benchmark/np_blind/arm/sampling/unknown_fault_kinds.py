"""Faults that no catalogue has, physically reasonable, and not to be called by any name of it."""

from __future__ import annotations

import numpy as np
from sim2real.excitation.suite import READY, SECOND, THIRD

from np_blind.arm.plant.physics import Physics
from np_blind.arm.sampling.faults import Parameters

SCALE = np.array([0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015])  # Nm of size 1
LOAD = np.array([3.0, 20.0, 8.0, 16.0, 1.0, 2.0, 0.4])  # Nm that the drives give now and then
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
    p.flutter[i, j], p.flutter_frequency[i, j] = min(1.5 * size / LOAD[j], 0.4), rng.uniform(0.8, 3.0)
    return {"share": (p.flutter[i, j], "1"), "frequency": (p.flutter_frequency[i, j], "Hz")}


def _dropout(p, i, j, size, rng):
    """A loose contact: the drive loses part of its torque for 60 ms, at random."""
    p.dropout[i, j] = min(3.0 * size / LOAD[j], 0.6)
    return {"share": (p.dropout[i, j], "1")}


def _coupling(p, i, j, size, rng):
    """A cable over two joints: motion of a neighbour drags on this one."""
    other = j - 1 if j else 1
    p.coupling[i, j, other] = size / 0.3 * rng.choice([-1.0, 1.0])
    return {"drag": (p.coupling[i, j, other], "Nms/rad"), "other_joint": (other + 1.0, "1")}


def _dent(p, i, j, size, rng):
    """A dent in a bearing's race: at one angle the balls roll into it, and are lifted out, without loss."""
    angle = READY[j] + rng.uniform(-0.12, 0.12)
    p.dent[i, j], p.dent_angle[i, j], p.dent_width[i, j] = 2.0 * size, angle, rng.uniform(0.02, 0.05)
    return {"torque": (2.0 * size, "Nm"), "angle": (angle, "rad")}


def _brake(p, i, j, size, rng):
    """A brake that does not let go at times: friction for some seconds, then none."""
    p.brake[i, j] = 1.5 * size
    return {"friction": (1.5 * size, "Nm")}


def _loose_part(p, i, j, size, rng):
    """A cover come loose: balanced mass on a weak spring, which swings after the link."""
    p.part_inertia[i, j], p.part_frequency[i, j] = 0.5 * size, rng.uniform(1.5, 5.0)
    p.part_damping[i, j] = rng.uniform(0.05, 0.15)
    return {"inertia": (0.5 * size, "kg m^2"), "frequency": (p.part_frequency[i, j], "Hz")}


def _taut(p, i, j, size, rng):
    """A cable too short: from some angle on it is taut, and pulls back."""
    side = rng.choice([-1.0, 1.0])
    p.taut[i, j], p.taut_side[i, j] = 10.0 * size, side
    p.taut_angle[i, j] = READY[j] + side * rng.uniform(0.05, 0.15)
    return {"stiffness": (10.0 * size, "Nm/rad"), "angle": (p.taut_angle[i, j], "rad")}


def _dead_zone(p, i, j, size, rng):
    """An amplifier with crossover distortion: it gives nothing of small commanded torques, either way."""
    p.dead_zone[i, j] = size
    return {"torque": (size, "Nm")}


def _fading(p, i, j, size, rng):
    """Magnets that warm up: the drive gives less and less of the commanded torque."""
    p.fading[i, j], p.fading_time[i, j] = min(1.5 * size / LOAD[j], 0.4), rng.uniform(30.0, 90.0)
    return {"share": (p.fading[i, j], "1"), "time": (p.fading_time[i, j], "s")}


def _eccentric(p, i, j, size, rng):
    """An encoder's disc off its centre: too much is shown on one side of the turn, too little on the other."""
    p.eccentric[i, j], p.eccentric_phase[i, j] = 3e-4 * size / SCALE[j], rng.uniform(0, 2 * np.pi)
    return {"amplitude": (p.eccentric[i, j], "rad"), "phase": (p.eccentric_phase[i, j], "rad")}


def _commutation(p, i, j, size, rng):
    """A motor's own encoder set askew: the drive gives more, or less, as the rotor turns."""
    p.commutation[i, j], p.commutation_order[i, j] = min(1.5 * size / LOAD[j], 0.3), rng.uniform(6.0, 20.0)
    p.commutation_phase[i, j] = rng.uniform(0, 2 * np.pi)
    return {"share": (p.commutation[i, j], "1"), "order": (p.commutation_order[i, j], "1/rad")}


def _wander(p, i, j, size, rng):
    """A current sensor whose zero wanders as it warms up: a torque that comes and goes in a minute or two."""
    p.wander[i, j], p.wander_time[i, j] = 2.0 * size, rng.uniform(50.0, 120.0)
    return {"torque": (2.0 * size, "Nm"), "time": (p.wander_time[i, j], "s")}


def _slip(p, i, j, size, rng):
    """An encoder's disc that slips on its shaft, once."""
    p.slip[i, j], p.slip_time[i, j] = 5e-4 * size / SCALE[j] * rng.choice([-1.0, 1.0]), rng.uniform(5.0, 14.0)
    return {"angle": (p.slip[i, j], "rad"), "time": (p.slip_time[i, j], "s")}


def _pack(p, i, j, size, rng):
    """A dress pack of hoses that rub on each other: a spring over some degrees, which then slides along."""
    p.pack[i, j], p.pack_stroke[i, j] = 3.0 * size, rng.uniform(0.05, 0.15)
    return {"torque": (3.0 * size, "Nm"), "stroke": (p.pack_stroke[i, j], "rad")}


def _grease(p, i, j, size, rng):
    """Grease that thins as it is sheared: drag that grows less and less with the speed."""
    p.grease[i, j], p.grease_speed[i, j] = 3.0 * size, rng.uniform(0.1, 0.3)
    return {"torque": (3.0 * size, "Nm"), "speed": (p.grease_speed[i, j], "rad/s")}


_ANY = (0, 1, 2, 3, 4, 5, 6)
FIRST = {
    "rub": (_rub, _ANY),
    "wavy_friction": (_wavy, _ANY),
    "hardening_spring": (_hardening, _ANY),
    "shaking": (_shake, _ANY),
    "ageing_friction": (_ageing, _ANY),
    "drive_flutter": (_flutter, (1, 2, 3, 5)),
    "drive_dropout": (_dropout, (1, 2, 3, 5)),
    "joint_coupling": (_coupling, (1, 2, 3, 4, 5, 6)),
}
LATER = {
    "bearing_dent": (_dent, _ANY),
    "dragging_brake": (_brake, _ANY),
    "loose_part": (_loose_part, _ANY),
    "taut_cable": (_taut, _ANY),
    "drive_dead_zone": (_dead_zone, (0, 2, 4, 6)),  # where gravity does not keep the torque away from zero
    "fading_drive": (_fading, (1, 2, 3, 5)),
    "eccentric_encoder": (_eccentric, _ANY),
}
NEWEST = {
    "commutation_error": (_commutation, (1, 2, 3, 5)),
    "wandering_zero": (_wander, _ANY),
    "slipped_encoder": (_slip, (0, 1, 2, 3, 4, 5)),
    "dress_pack": (_pack, _ANY),
    "thinning_grease": (_grease, _ANY),
}

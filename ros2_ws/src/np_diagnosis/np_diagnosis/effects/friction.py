"""joint_dynamics: friction in all its forms, rotor, cable, ripple, drift. All show in r2 only."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from np_diagnosis.arm import rigid
from np_diagnosis.arm.model import INERTIA_ERROR, SURE, Arm
from np_diagnosis.arm.stages import sign
from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, recurrence, stack

GAZ = "Gaz et al., RA-L 2019"
# So fine that the best one leaves nothing to other effects.
STRIBECK_SPEEDS = tuple(0.03 * 1.4**n for n in range(7))  # rad/s
PRESLIDING_STROKES = tuple(0.003 * 1.4**n for n in range(9))  # rad
# rad: the catalogue has 3 to 30 mrad; hoses and seals that slide after more follow the same law by another cause.
PRESLIDING_MOST = 0.045
SMOOTH = 5  # samples of the fine grid
TINY = 1e-300  # where nothing moves at all
WARM_UP = (40.0, 70.0, 110.0, 180.0)  # s


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint."""
    arm = context.arm
    coulomb = partial(_resisting, unit="Nm", upper=4.0, prior=0.3, nominal=arm.frictionloss)
    viscous = partial(_resisting, unit="Nms/rad", upper=8.0, prior=0.3, nominal=arm.damping)
    found = [
        Effect(
            "coulomb_friction",
            (coulomb("level"),),
            {"r2": lambda c, j: stack(c.prediction.direction[:, j])},
            GAZ,
        ),
        Effect(
            "asymmetric_coulomb_friction",
            (coulomb("level_positive"), coulomb("level_negative")),
            {
                # From the one level to the other through their mean: the forces of Coulomb friction with an offset, at
                # a turn as well, or turns would seem to tell the two apart.
                "r2": lambda c, j: stack(
                    c.samples.filtered(j, lambda q, v: (sign(v) + 1) / 2),
                    c.samples.filtered(j, lambda q, v: (sign(v) - 1) / 2),
                )
            },
            GAZ,
        ),
        Effect(
            "viscous_friction",
            (viscous("coefficient"),),
            {"r2": lambda c, j: stack(c.samples.velocity[:, j])},
            GAZ,
        ),
        Effect(
            "asymmetric_viscous_friction",
            (viscous("coefficient_positive"), viscous("coefficient_negative")),
            {
                "r2": lambda c, j: stack(
                    c.samples.filtered(j, lambda q, v: np.maximum(v, 0)),
                    c.samples.filtered(j, lambda q, v: np.minimum(v, 0)),
                )
            },
            GAZ,
        ),
        Effect(
            "load_dependent_friction",
            (Parameter("coefficient", "1", 0.0, 0.5, 0.05),),
            {"r2": lambda c, j: stack(np.abs(c.prediction.load[:, j]) * c.prediction.direction[:, j])},
            "friction proportional to the load through the gear",
        ),
        *(_armature(arm, joint) for joint in range(len(arm))),
        Effect(
            "cable_torque",
            (Parameter("stiffness", "Nm/rad", 0.0, 3.0, 0.3), Parameter("offset", "Nm", -1.0, 1.0, 0.1)),
            {"r2": lambda c, j: stack(c.samples.position[:, j] - c.arm.rest[j], np.ones(len(c.samples)))},
            "a spring, and its torque in the rest posture",
        ),
    ]
    found += [_stribeck(v) for v in STRIBECK_SPEEDS]
    found += [_presliding(x) for x in PRESLIDING_STROKES]
    found += [_drift("linear in time", lambda u, total: u / total)]
    found += [_drift(f"warming up in {s:g} s", lambda u, total, s=s: 1 - np.exp(-u / s)) for s in WARM_UP]
    found += [_ripple(j, order) for j, orders in context.ripples.items() for order in orders]
    return found


def _armature(arm: Arm, joint: int) -> Effect:
    """A rotor is told from the links that the joint turns where it is larger than their errors together."""
    links = rigid.own_sizes(arm)[rigid.carried(arm, joint)]
    least = SURE * INERTIA_ERROR * float(np.linalg.norm(links))
    change = _resisting("inertia", "kg m^2", 1.0, 0.15, arm.armature)
    return Effect(
        "armature",
        (replace(change, least=least),),
        {"r2": lambda c, j: stack(c.samples.acceleration[:, j])},
        "inertia of the rotor, reflected",
        only_joint=joint,
    )


def _resisting(name: str, unit: str, upper: float, prior: float, nominal: np.ndarray) -> Parameter:
    """A change of what resists the motion: no joint has less than none of it."""
    return Parameter(name, unit, -float(nominal.max()), upper, prior)


def _stribeck(speed: float) -> Effect:
    return Effect(
        "stribeck_friction",
        (Parameter("breakaway", "Nm", 0.0, 2.0, 0.2),),
        {
            "r2": lambda c, j: stack(
                c.samples.filtered(j, lambda q, v: sign(v) * np.exp(-((v / speed) ** 2))),
            )
        },
        "Armstrong-Helouvry et al., Automatica 1994",
        f"{speed:.3g} rad/s",
        Shape("speed", "rad/s", speed, _stribeck),
    )


def _presliding(stroke: float) -> Effect:
    """More friction, of a kind that builds up over a distance instead of at once."""

    def columns(c: Context, j: int) -> np.ndarray:
        return stack(c.samples.filtered(j, lambda q, v: dahl(q, stroke)))

    return Effect(
        "presliding_friction",
        (Parameter("level", "Nm", 0.0, 4.0, 0.4),),
        {"r2": columns},
        "Dahl 1968: dF/dx = (Fc - F sgn v) / x0",
        f"{1e3 * stroke:.3g} mrad",
        Shape("stroke", "rad", stroke, _presliding, upper=PRESLIDING_MOST),
    )


def _drift(variant: str, course) -> Effect:
    """Friction that changes over the recording: a share of what the nominal joint has."""

    def columns(c: Context, j: int) -> np.ndarray:
        since = c.samples.time + _begin(c)[c.samples.trajectory]
        total = since.max() if len(since) else 1.0
        return stack(course(since, total) * c.prediction.friction[:, j])

    return Effect(
        "thermal_drift",
        (Parameter("change", "1", -0.9, 0.9, 0.2),),
        {"r2": columns},
        "friction falls as the grease warms up",
        variant,
    )


def _begin(c: Context) -> np.ndarray:
    """s from the first recording to each one, recorded one after the other."""
    return np.concatenate([[0.0], np.cumsum([log.duration for log in c.logs])[:-1]])


def _ripple(joint: int, order: int) -> Effect:
    return Effect(
        "torque_ripple",
        (Parameter("sine", "Nm", -3.0, 3.0, 0.1), Parameter("cosine", "Nm", -3.0, 3.0, 0.1)),
        {
            "r2": lambda c, j: stack(
                c.samples.filtered(j, lambda q, v: np.sin(order * q)),
                c.samples.filtered(j, lambda q, v: np.cos(order * q)),
            )
        },
        "order of the wave generator",
        f"order {order}",
        only_joint=joint,
        constants={"order": float(order)},
    )


def dahl(position: np.ndarray, stroke: float) -> np.ndarray:
    """Dahl's friction (m,) over its level, -1..1, from the distance moved; exact for motion that does not
    turn between two samples."""
    # An encoder's noise is no motion: over a short stroke it would wear the state away.
    smooth = np.convolve(np.pad(position, SMOOTH // 2, mode="edge"), np.full(SMOOTH, 1 / SMOOTH), mode="valid")
    return sliding(np.diff(smooth, prepend=smooth[:1]), stroke)


def sliding(moved: np.ndarray, stroke: float, shaken: float = 0.0) -> np.ndarray:
    """z (m,), -1..1, of dz = (dx - |dx| z) / stroke for steps `moved` (m,): Dahl's and Bouc and Wen's state. shaken: what
    moves to and fro besides in each step, across rather than on top of it; it lets go of z and winds nothing up."""
    path = np.maximum(np.hypot(moved, shaken), TINY)
    decay = np.exp(-path / stroke)
    return recurrence(decay, moved / path * (1 - decay))

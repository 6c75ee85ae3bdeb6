"""joint_dynamics: friction in all its forms, rotor, cable, ripple, drift. All show in r2 only."""

from __future__ import annotations

import numpy as np

from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, recurrence, stack
from np_diagnosis.stages import sign

GAZ = "Gaz et al., RA-L 2019"
COULOMB = ("Nm", -1.0, 4.0, 0.3)
VISCOUS = ("Nms/rad", -1.0, 8.0, 0.3)
STRIBECK_SPEEDS = (0.03, 0.06, 0.12, 0.25)  # rad/s
PRESLIDING_STROKES = (0.003, 0.006, 0.012, 0.025, 0.05)  # rad
SMOOTH = 5  # samples of the fine grid
WARM_UP = (60.0, 180.0)  # s


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint."""
    found = [
        Effect(
            "coulomb_friction",
            (Parameter("level", *COULOMB),),
            {"r2": lambda c, j: stack(c.prediction.direction[:, j])},
            GAZ,
        ),
        Effect(
            "asymmetric_coulomb_friction",
            (Parameter("level_positive", *COULOMB), Parameter("level_negative", *COULOMB)),
            {
                "r2": lambda c, j: stack(
                    c.samples.filtered(j, lambda q, v: np.maximum(sign(v), 0)),
                    c.samples.filtered(j, lambda q, v: np.minimum(sign(v), 0)),
                )
            },
            GAZ,
        ),
        Effect(
            "viscous_friction",
            (Parameter("coefficient", *VISCOUS),),
            {"r2": lambda c, j: stack(c.samples.velocity[:, j])},
            GAZ,
        ),
        Effect(
            "asymmetric_viscous_friction",
            (Parameter("coefficient_positive", *VISCOUS), Parameter("coefficient_negative", *VISCOUS)),
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
            (Parameter("coefficient", "1", -0.1, 0.5, 0.05),),
            {"r2": lambda c, j: stack(np.abs(c.prediction.load[:, j]) * c.prediction.direction[:, j])},
            "friction proportional to the load through the gear",
        ),
        Effect(
            "armature",
            (Parameter("inertia", "kg m^2", -0.2, 1.0, 0.15),),
            {"r2": lambda c, j: stack(c.samples.acceleration[:, j])},
            "inertia of the rotor, reflected",
        ),
        Effect(
            "cable_torque",
            (Parameter("stiffness", "Nm/rad", -3.0, 3.0, 0.3),),
            {"r2": lambda c, j: stack(c.samples.position[:, j] - c.arm.rest[j])},
            "spring about the rest posture",
        ),
    ]
    found += [_stribeck(v) for v in STRIBECK_SPEEDS]
    found += [_presliding(x) for x in PRESLIDING_STROKES]
    found += [_drift("linear in time", lambda u, total: u / total)]
    found += [_drift(f"warming up in {s:g} s", lambda u, total, s=s: 1 - np.exp(-u / s)) for s in WARM_UP]
    found += [_ripple(j, order) for j, orders in context.ripples.items() for order in orders]
    return found


def _stribeck(speed: float) -> Effect:
    return Effect(
        "stribeck_friction",
        (Parameter("breakaway", "Nm", -1.0, 2.0, 0.2),),
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
        Shape("stroke", "rad", stroke, _presliding),
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
    moved = np.diff(smooth, prepend=smooth[:1])
    decay = np.exp(-np.abs(moved) / stroke)
    return recurrence(decay, np.sign(moved) * (1 - decay))

"""Friction curve: friction by speed and direction, free of any law.

Linear between values at given speeds, constant below the first and straight on beyond the last. Coulomb, viscous, Stribeck and
asymmetric friction are special cases, and are preferred where they predict as well (`ModelSearch.use_curves`).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction, smooth_direction
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.recurrences import smooth_sign
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

SPEEDS = (0.03, 0.06, 0.1, 0.16, 0.3, 0.8)  # rad/s: dense where the friction of a strain-wave gear falls
WAYS = ("positive", "negative")
MOST = 4.0  # Nm
CREEPING = 0.02  # of a joint's friction: standard deviation of what any arm has below the first speed, where the curve is level


def value_name(way: str, speed: float) -> str:
    """Of the quantity for one of `WAYS` and one of `SPEEDS`."""
    return f"{way}_{1e3 * speed:.0f}"  # mrad/s


def _sections(speed: np.ndarray) -> list[np.ndarray]:
    """Share 0..1 (...) of each section between two speeds that lies below |speed| (...) rad/s; of the last one, beyond 1."""
    last = len(SPEEDS) - 2
    return [
        ((abs(speed) - low) / (high - low)).clip(0.0, None if number == last else 1.0)
        for number, (low, high) in enumerate(pairwise(SPEEDS))
    ]


def _hats(speed: np.ndarray) -> list[np.ndarray]:
    """Weights (...) of the values at `SPEEDS`, which sum to one."""
    shares = [1.0, *_sections(speed), 0.0]
    return [one - other for one, other in pairwise(shares)]


def _columns(c: Context, j: int) -> np.ndarray:
    def column(hat: int, way: int) -> np.ndarray:
        return c.samples.filter_function(j, lambda q, v: _hats(v)[hat] * np.maximum(way * smooth_sign(v), 0.0) * way)

    return stack(*(column(hat, way) for way in (1, -1) for hat in range(len(SPEEDS))))


def _regressors(context: Context) -> list[EffectRegressor]:
    # No joint has less than no friction.
    unsure = CREEPING * float(context.arm.frictionloss.mean())
    level, slope = float(context.arm.frictionloss.max()), float(context.arm.damping.max())
    return [
        EffectRegressor(
            "friction_curve",
            tuple(
                Parameter(
                    value_name(way, v),
                    "Nm",
                    -level - slope * v,
                    MOST,
                    0.3,
                    background=unsure if v == SPEEDS[0] else 0.0,
                    is_in_whitening=False,
                )
                for way in WAYS
                for v in SPEEDS
            ),
            {Stage.DYNAMICS: _columns},
            "piecewise linear in speed",
        )
    ]


def _base(values: dict[str, float]) -> float:
    """Dry friction Nm of both directions near standstill, which a rigid-body simulator has a number for."""
    return 0.5 * sum(values[value_name(way, SPEEDS[0])] for way in WAYS)


def _curve_torque(values: HookContext) -> ResistanceFunction:
    forward, backward = ([values(value_name(way, v)) for v in SPEEDS] for way in WAYS)
    base = 0.5 * (forward[0] + backward[0])

    def curve(levels: list[np.ndarray], sections: list[np.ndarray]) -> np.ndarray:
        return levels[0] - base + sum((b - a) * share for (a, b), share in zip(pairwise(levels), sections))

    def resist(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        direction, sections = smooth_direction(dq), _sections(dq)
        return curve(forward, sections) * direction.clip(0.0, None) + curve(backward, sections) * direction.clip(
            None, 0.0
        )

    return resist


EFFECT = Effect(
    "friction_curve",
    EffectTarget.JOINT,
    tuple(Quantity(value_name(way, v), "Nm", -20.0, 20.0) for way in WAYS for v in SPEEDS),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(panda, "frictionloss", component, _base(v)),
    joints=_curve_torque,
    shows_in_motion=False,
    sentence_template="{at} has another friction curve: forwards {positive_30:Nm more/less} at 0.03 rad/s and "
    "{positive_300:Nm more/less} at 0.3 rad/s, backwards {negative_30:Nm more/less} and {negative_300:Nm more/less}",
    special_cases=(
        "coulomb_friction",
        "asymmetric_coulomb_friction",
        "viscous_friction",
        "asymmetric_viscous_friction",
        "stribeck_friction",
    ),
)

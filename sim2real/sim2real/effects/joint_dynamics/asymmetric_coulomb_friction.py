"""Coulomb friction of another level in each direction."""

from __future__ import annotations

from functools import partial

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction, smooth_direction
from sim2real.effects.joint_arrays import add_to_joints
from sim2real.effects.recurrences import bristle_deflection
from sim2real.effects.regressor import EffectRegressor, NonlinearParameter, Parameter, stack
from sim2real.effects.stage import Stage

POSITIVE, NEGATIVE = Quantity("level_positive", "Nm", -4.0, 4.0), Quantity("level_negative", "Nm", -4.0, 4.0)
REACH = Quantity("reach", "rad", 0.0, 0.05)  # half of the way on which it turns over; no simulated arm has it
# rad: longer than any arm's own friction takes. More friction on the same bristles bends them further.
REACHES = (0.0007, 0.0014, 0.0028, 0.0056, 0.0112)
MOST = 0.02
# Of the joint's own friction, which is on the same bristles.
_NOMINAL_SHARE = Parameter("share", "1", 0.0, 2.0, 0.3, 1.0)


def _levels(lower: float) -> tuple[Parameter, ...]:
    return tuple(Parameter(q.name, "Nm", lower, q.upper, 0.3) for q in (POSITIVE, NEGATIVE))


def _make_immediate_regressor(lower: float) -> EffectRegressor:
    """From the one level to the other through their mean: the forces of Coulomb friction with an offset, at a turn as well,
    or turns would seem to distinguish the two."""
    return EffectRegressor(
        "asymmetric_coulomb_friction",
        _levels(lower),
        {Stage.DYNAMICS: lambda c, j: stack(*_direction_shares(c.prediction.direction[:, j]))},
        "Gaz et al., RA-L 2019",
    )


def _make_bristle_regressor(reach: float, lower: float) -> EffectRegressor:
    """The same on bristles that a reversal bends by twice the reach, rad. As presliding friction with an offset these would be
    two effects in place of one."""
    return EffectRegressor(
        "asymmetric_coulomb_friction",
        (*_levels(lower), _NOMINAL_SHARE),
        {Stage.DYNAMICS: partial(_bristle_columns, reach=reach)},
        "Prandtl 1928: a bristle that bends, then slides",
        f"turns over within {1e3 * reach:.3g} mrad",
        NonlinearParameter(REACH.name, "rad", reach, partial(_make_bristle_regressor, lower=lower), upper=MOST),
    )


def _direction_shares(turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (n,) of the level forwards and of that backwards, of how far friction has turned over (n,), -1 to 1."""
    return (turned + 1) / 2, (turned - 1) / 2


def _bristle_columns(c: Context, j: int, reach: float) -> np.ndarray:
    turned = c.samples.filter_function(j, lambda q, v: bristle_deflection(q, reach))
    return stack(*_direction_shares(turned), c.arm.frictionloss[j] * (turned - c.prediction.direction[:, j]))


def _regressors(context: Context) -> list[EffectRegressor]:
    lower = -float(context.arm.frictionloss.max())
    return [_make_immediate_regressor(lower), *(_make_bristle_regressor(reach, lower) for reach in REACHES)]


def _asymmetric_torque(values: HookContext) -> ResistanceFunction:
    # Half the sum of both levels slows both ways (`panda`); half their difference is a torque of one sign.
    half = 0.5 * (values("level_positive") - values("level_negative"))
    return lambda q, dq: half * abs(smooth_direction(dq))


EFFECT = Effect(
    "asymmetric_coulomb_friction",
    EffectTarget.JOINT,
    (POSITIVE, NEGATIVE, REACH),
    _regressors,
    DetectionLimit("Nm", (0.06, 0.06, 0.05, 0.05, 0.02, 0.02, 0.015), (1, 2, 3, 4, 5, 6, 7)),
    modify_rigid_body=lambda panda, component, v: add_to_joints(
        panda, "frictionloss", component, 0.5 * (v["level_positive"] + v["level_negative"])
    ),
    joints=_asymmetric_torque,
    sentence_template="{at} has {level_positive:Nm more/less} dry friction when it turns forwards and {level_negative:Nm more/less} backwards",
)

"""Torque saturation: the largest torque that the drive gives, the gravity that it compensates included."""

from __future__ import annotations

from functools import partial

import numpy as np

from np_common.rotations import namespace
from sim2real.effects import hooks
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context, Drive
from sim2real.effects.hooks import DriveHook, DriveSlot, HookContext, infinite_where_zero
from sim2real.effects.limits import GRAVITY_APART, DriveLimit, candidate_levels, limit_column
from sim2real.effects.regressor import WHOLE, EffectRegressor, NonlinearParameter, stack
from sim2real.effects.stage import Stage

LIMIT = Quantity("limit", "Nm", 0.0, 200.0)


def saturate(d: Drive, values: np.ndarray, limit: float, measured: np.ndarray | None = None) -> np.ndarray:
    """values (n,) Nm within a limit Nm. It has no memory: past torques do not matter."""
    return np.clip(values, -limit, limit)


def _regressor(limit: float, joint: int, gravity_apart: bool) -> EffectRegressor:
    return EffectRegressor(
        "torque_saturation",
        (WHOLE,),
        {Stage.DRIVE: lambda c, j: stack(limit_column(c.drive, j, saturate, limit, gravity_apart))},
        "largest torque of the drive",
        f"{limit:.3g} Nm{', gravity apart' if gravity_apart else ''}",
        NonlinearParameter("limit", "Nm", limit, partial(_regressor, joint=joint, gravity_apart=gravity_apart)),
        only_joint=joint,
        constants={GRAVITY_APART.name: 1.0} if gravity_apart else {},
    )


def _levels(context: Context, joint: int, gravity_apart: bool, rows: np.ndarray) -> list[float]:
    """Limits Nm to try for rows (n,) bool of the drive."""
    d = context.drive
    gravity = 0.0 if gravity_apart else d.gravity[:, joint]
    return candidate_levels(d.commanded[:, joint] + gravity, (d.measured[:, joint] + gravity)[rows])


def _saturate(values: HookContext) -> hooks.DriveFunction:
    limit = infinite_where_zero(values("limit"))
    return lambda torque: namespace(torque).clip(torque, -limit, limit)


_LIMIT = DriveLimit(saturate, _levels, _regressor)

EFFECT = Effect(
    "torque_saturation",
    EffectTarget.JOINT,
    (LIMIT, GRAVITY_APART),
    _LIMIT.regressors,
    DetectionLimit("share of the suite's peak", (0.07,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=DriveHook(DriveSlot.LIMIT, _saturate, of_total=True),
    reference_regressors=_LIMIT.reference_regressors,
    sentence_template="the drive of {at} gives no more than {limit:Nm}",
)

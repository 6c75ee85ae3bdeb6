"""A low-pass filter on the commanded torque (libfranka: 100 Hz). The controller's own: no simulated arm carries it."""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.recurrences import first_order_lag
from sim2real.effects.regressor import SHARE, EffectRegressor, NonlinearParameter, stack
from sim2real.effects.stage import Stage

TIME_CONSTANT = Quantity("time_constant", "s", 0.0, 0.2)
FILTERS = tuple(4e-4 * 1.35**n for n in range(14))  # s: so fine that the best one leaves nothing to other effects


def _regressor(lag: float) -> EffectRegressor:
    def columns(c: Context, j: int) -> np.ndarray:
        return stack(first_order_lag(c.drive, c.drive.law[:, j], lag) - c.drive.law[:, j])

    return EffectRegressor(
        "controller_mismatch",
        (SHARE,),
        {Stage.CONTROLLER: columns},
        "low-pass filter on the commanded torque (libfranka: 100 Hz)",
        f"{1e3 * lag:.3g} ms",
        NonlinearParameter("time_constant", "s", lag, _regressor, linear=True, least=1e-4),
        is_arm=True,
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [] if context.drive is None else [_regressor(lag) for lag in FILTERS]


EFFECT = Effect(
    "controller_mismatch",
    EffectTarget.ARM,
    (TIME_CONSTANT,),
    _regressors,
    DetectionLimit("s", 5e-4),
    sentence_template="the controller filters its torque, which {nominal} does not, with a time constant of {time_constant:ms}",
)

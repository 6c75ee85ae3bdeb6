"""Actuator lag: a torque loop of first order. A period's torque is its mean, in the measurement and in the arm that moves by it."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DriveFunction, DriveHook, DriveSlot, HookContext
from sim2real.effects.recurrences import mean_lagged_torque
from sim2real.effects.regressor import SHARE, EffectRegressor, NonlinearParameter, stack
from sim2real.effects.stage import Stage

TIME_CONSTANT = Quantity("time_constant", "s", 0.0, 0.2)
LAGS = tuple(1e-3 * 1.4**n for n in range(10))  # s: so fine that the best one leaves nothing to other effects
AVERAGE_KNOWN = 4e-4  # s: whether a period's measured torque is its mean or its end makes .4 of a period


def _regressor(lag: float) -> EffectRegressor:
    return EffectRegressor(
        "actuator_lag",
        (SHARE,),
        {
            Stage.DRIVE: lambda c, j: stack(
                mean_lagged_torque(c.drive, c.drive.arrived[:, j], lag) - c.drive.arrived[:, j]
            )
        },
        "first-order torque loop",
        f"{1e3 * lag:.3g} ms",
        NonlinearParameter("time_constant", "s", lag, _regressor, linear=True, background=AVERAGE_KNOWN, least=4e-4),
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [] if context.drive is None else [_regressor(lag) for lag in LAGS]


def _lag(values: HookContext) -> DriveFunction:
    lag, through = values("time_constant"), None
    xp = namespace(lag)
    decay = xp.where(lag > 0, xp.exp(-values.period / lag.clip(1e-9)), 0.0)
    mean = lag / values.period * (1 - decay)

    def drive(torque: np.ndarray) -> np.ndarray:
        nonlocal through
        begin = torque if through is None else through
        through = torque + (begin - torque) * decay
        return torque + (begin - torque) * mean

    return drive


EFFECT = Effect(
    "actuator_lag",
    EffectTarget.JOINT,
    (TIME_CONSTANT,),
    _regressors,
    DetectionLimit("s", (1e-3,) * 7, (1, 2, 3, 4, 5, 6, 7), largest=6),
    drive=DriveHook(DriveSlot.LAG, _lag),
    sentence_template="the drive of {at} lags behind its command, with a time constant of {time_constant:ms}",
)

"""software: a controller that is not the one it should be. Shows in r0, the replayed law."""

from __future__ import annotations

import numpy as np

from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, stack
from np_diagnosis.effects.torque_loop import SHARE, first_order

FILTERS = tuple(4e-4 * 1.35**n for n in range(14))  # s: so fine that the best one leaves nothing to other effects


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint; none without commands."""
    if context.drive is None:
        return []
    change = Parameter("relative", "1", -0.9, 3.0, 0.1, least=0.003)
    law = "tau = kp (q_d - q) - kd dq"
    return [
        Effect(
            "stiffness_gain_error",
            (change,),
            {"r0": lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j])},
            law,
        ),
        Effect(
            "damping_gain_error",
            (change,),
            {"r0": lambda c, j: stack(-c.drive.damping[:, j] * c.drive.velocity[:, j])},
            law,
        ),
        # A target ahead by kd/kp of its velocity is part of the law: with the wrong gain it is another one.
        Effect(
            "stiffness_gain_error",
            (change,),
            {"r0": lambda c, j: stack(c.drive.stiffness[:, j] * c.drive.error[:, j] - _lead(c, j))},
            law,
            "lead with the wrong gain",
        ),
        Effect(
            "damping_gain_error",
            (change,),
            {"r0": lambda c, j: stack(_lead(c, j) - c.drive.damping[:, j] * c.drive.velocity[:, j])},
            law,
            "lead with the wrong gain",
        ),
        *(_filter(t) for t in FILTERS),
    ]


def _lead(c: Context, j: int) -> np.ndarray:
    """Torque (n,) of the law by which the target is ahead."""
    return c.drive.damping[:, j] * c.drive.target_velocity[:, j]


def _filter(lag: float) -> Effect:
    def columns(c: Context, j: int) -> np.ndarray:
        return stack(first_order(c.drive, c.drive.law[:, j], lag) - c.drive.law[:, j])

    return Effect(
        "controller_mismatch",
        (SHARE,),
        {"r0": columns},
        "low-pass filter on the commanded torque (libfranka: 100 Hz)",
        f"{1e3 * lag:.3g} ms",
        Shape("time_constant", "s", lag, _filter, linear=True, least=1e-4),
        is_arm=True,
    )

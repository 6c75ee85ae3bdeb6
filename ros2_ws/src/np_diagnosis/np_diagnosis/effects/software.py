"""software: a controller that is not the one it should be. Shows in r0, the replayed law."""

from __future__ import annotations

import numpy as np

from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, stack
from np_diagnosis.effects.torque_loop import SHARE, first_order

FILTERS = (0.0016, 0.004, 0.01, 0.025)  # s


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint; none without commands."""
    if context.drive is None:
        return []
    return [
        Effect(
            "stiffness_gain_error",
            (Parameter("change", "Nm/rad", -600.0, 600.0, 30.0),),
            {"r0": lambda c, j: stack(c.drive.error[:, j])},
            "tau = kp (q_d - q) - kd dq",
        ),
        Effect(
            "damping_gain_error",
            (Parameter("change", "Nms/rad", -60.0, 60.0, 3.0),),
            {"r0": lambda c, j: stack(-c.drive.velocity[:, j])},
            "tau = kp (q_d - q) - kd dq",
        ),
        *(_filter(t) for t in FILTERS),
    ]


def _filter(lag: float) -> Effect:
    def columns(c: Context, j: int) -> np.ndarray:
        return stack(first_order(c.drive, c.drive.law[:, j], lag) - c.drive.law[:, j])

    return Effect(
        "controller_mismatch",
        (SHARE,),
        {"r0": columns},
        "low-pass filter on the commanded torque (libfranka: 100 Hz)",
        f"{1e3 * lag:.3g} ms",
        Shape("time_constant", "s", lag, _filter, linear=True),
    )

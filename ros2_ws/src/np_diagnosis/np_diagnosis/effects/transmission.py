"""transmission: what lies between motor and joint. Shows in r3, where the backend has the motor's angle."""

from __future__ import annotations

from functools import partial

import numpy as np

from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, stack
from np_diagnosis.effects.friction import sliding

HYSTERESIS_STROKES = (1e-4, 2e-4, 4e-4, 1e-3)  # rad of twist over which the loop saturates
# rad/s of twist to and fro, too fast to be seen, by which noise of the commands shakes a gear. It lets go of what is wound
# up: taken for still, a gear that is shaken looks half as wide.
SHAKING = (0.0, 8e-5)
# How well width and stroke are known at best: how fast a gear is shaken is known to a factor, and they trade against it.
# Learnt on four arms of an opened set, where by these widths six of eight numbers are held, by the bare intervals three.
HYSTERESIS_MODEL = 0.3
PLAY_TORQUE = 4e-4  # of the torque limit, at which the side of the play is sure
PLAY_KNOWN = 1e-5  # rad


def effects(context: Context) -> list[Effect]:
    """Effects of a single joint; none without motor angles."""
    if context.transmission is None:
        return []
    return [
        Effect(
            "joint_elasticity",
            (Parameter("compliance", "rad/Nm", 0.0, 0.01, 3e-4), Parameter("damping_time", "s", -1e-5, 1e-5, 1e-7)),
            {"r3": lambda c, j: stack(c.transmission.load[:, j], c.transmission.load_rate[:, j])},
            "tau = K (motor - joint) + D (motor rate - joint rate)",
        ),
        Effect(
            "backlash",
            (Parameter("half_play", "rad", 0.0, 0.05, 1e-3, background=PLAY_KNOWN),),
            {"r3": lambda c, j: stack(_side(c, j))},
            "play operator: the motor leads by half the play, whichever side drives",
        ),
        *(_hysteresis(x, shaking) for shaking in SHAKING for x in HYSTERESIS_STROKES),
    ]


def _side(c: Context, j: int) -> np.ndarray:
    """Which side of the play the load (n,) is carried by, -1..1."""
    return np.tanh(c.transmission.load[:, j] / (PLAY_TORQUE * c.arm.torque_limit[j]))


def _hysteresis(stroke: float, shaking: float) -> Effect:
    def columns(c: Context, j: int) -> np.ndarray:
        # K (twist + width z) = tau: z winds up with the twist, and takes up part of the torque.
        wound = [
            sliding(np.diff(w[:, j], prepend=w[:1, j]), stroke, shaking * (grid[1] - grid[0]))
            for w, (_, grid) in zip(c.transmission.wound, c.samples.grids)
        ]
        return -stack(c.samples.filter(wound))

    return Effect(
        "transmission_hysteresis",
        (Parameter("width", "rad", 0.0, 0.05, 3e-4),),
        {"r3": columns},
        "Bouc-Wen on the twist (Wen, J. Eng. Mech. 1976; n = 1): dz = du - |du| z / stroke",
        f"{1e3 * stroke:.3g} mrad{', shaken' if shaking else ''}",
        Shape("stroke", "rad", stroke, partial(_hysteresis, shaking=shaking)),
        model=HYSTERESIS_MODEL,
    )

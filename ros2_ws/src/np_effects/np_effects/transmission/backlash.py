"""Backlash: the motor leads by half the play, whichever side drives. No simulated arm has the motor's side."""

from __future__ import annotations

import numpy as np

from np_effects.evidence import Context
from np_effects.record import EffectRecord, Place, Quantity, Visible
from np_effects.signature import Parameter, Signature, stack
from np_effects.stage import Stage

HALF_PLAY = Quantity("half_play", "rad", 0.0, 0.05)
PLAY_TORQUE = 4e-4  # of the torque limit, at which the side of the play is sure
PLAY_KNOWN = 1e-5  # rad


def _side(c: Context, j: int) -> np.ndarray:
    """Which side of the play the load (n,) is carried by, -1..1."""
    return np.tanh(c.transmission.load[:, j] / (PLAY_TORQUE * c.arm.torque_limit[j]))


def _signatures(context: Context) -> list[Signature]:
    if context.transmission is None:
        return []
    return [
        Signature(
            "backlash",
            (Parameter("half_play", "rad", HALF_PLAY.lower, HALF_PLAY.upper, 1e-3, background=PLAY_KNOWN),),
            {Stage.TRANSMISSION: lambda c, j: stack(_side(c, j))},
            "play operator: the motor leads by half the play, whichever side drives",
        )
    ]


RECORD = EffectRecord(
    "backlash",
    Place.JOINT,
    (HALF_PLAY,),
    _signatures,
    Visible("rad", (1e-4,) * 7, (1, 2, 3, 4, 5, 6, 7)),
)

"""A base that stands crooked: gravity comes from another side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage
from sim2real.effects.weight import Weight

ROLL, PITCH = Quantity("roll", "rad", -0.2, 0.2), Quantity("pitch", "rad", -0.2, 0.2)


def _signatures(context: Context) -> list[Signature]:
    """Gravity turned about the base's x and y axis, by small angles."""
    size = np.linalg.norm(context.arm.gravity)
    about_x = context.rigid.gravity_torque(np.array([0.0, -size, 0.0]))
    about_y = context.rigid.gravity_torque(np.array([size, 0.0, 0.0]))
    return [
        Signature(
            "base_tilt",
            tuple(Parameter(q.name, "rad", q.lower, q.upper, 0.01) for q in (ROLL, PITCH)),
            {Stage.DYNAMICS: lambda c, j: stack(about_x[:, j], about_y[:, j])},
            "gravity in the frame of a base that stands crooked",
            is_arm=True,
            model=WEIGHT_KNOWN,
        )
    ]


def _tilt(weight: Weight, component: str, values: Mapping[str, float]) -> Weight:
    roll, pitch = weight.tilt
    return replace(weight, tilt=(roll + values["roll"], pitch + values["pitch"]))


RECORD = EffectRecord(
    "base_tilt",
    Place.ARM,
    (ROLL, PITCH),
    _signatures,
    Visible("rad", 0.0015),
    weight=_tilt,
    said="the base stands crooked: {roll:deg} about x and {pitch:deg} about y",
)

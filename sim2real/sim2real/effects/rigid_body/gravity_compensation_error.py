"""Gravity compensation that is too strong or too weak."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sim2real.effects.background import WEIGHT_KNOWN
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord, Place, Quantity, Visible
from sim2real.effects.signature import Parameter, Signature, stack
from sim2real.effects.stage import Stage
from sim2real.effects.weight import Weight

SCALE = Quantity("scale", "1", -0.3, 0.3)


def _signatures(context: Context) -> list[Signature]:
    return [
        Signature(
            "gravity_compensation_error",
            (Parameter("scale", "1", SCALE.lower, SCALE.upper, 0.03),),
            {Stage.DYNAMICS: lambda c, j: stack(-c.prediction.gravity[:, j])},
            "scale of the compensated gravity",
            is_arm=True,
            model=WEIGHT_KNOWN,
        )
    ]


def _share(weight: Weight, component: str, values: Mapping[str, float]) -> Weight:
    return replace(weight, share=weight.share + values["scale"])


RECORD = EffectRecord(
    "gravity_compensation_error",
    Place.ARM,
    (SCALE,),
    _signatures,
    Visible("1", 0.005),
    weight=_share,
    said="gravity compensation is {scale:% too_strong/too_weak}",
)

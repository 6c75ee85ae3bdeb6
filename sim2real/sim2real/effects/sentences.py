"""An effect in words, for who reads a report: the phrase of its record with the numbers that were found in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, floor, log10
from string import Formatter

from sim2real.effects.effect import ARM, ARM_TARGETS, Effect, EffectTarget

_SCALES = {"%": 100.0, "ppm": 1e6, "ms": 1e3, "mm": 1e3, "mrad": 1e3, "mrad/Nm": 1e3, "deg": degrees(1.0)}
"""Units that a phrase may use in place of the quantity's own, with their scale."""


@dataclass(frozen=True)
class ValueWithInterval:
    """A number that was found, with its 95 % interval, in the quantity's own unit.

    In a phrase "{level:Nm more/less}" gives it in Nm, with the word for its sign; "{share:%}" gives per cent. Within a unit
    or a word an underscore stands for a blank.
    """

    value: float
    """The estimate."""
    low: float
    """Lower end of its interval."""
    high: float
    """Upper end."""

    def __format__(self, spec: str) -> str:
        unit, _, words = spec.partition(" ")
        scale = _SCALES.get(unit, 1.0)
        word = ""
        if words:
            above, below = words.split("/")
            word = f" {above if self.value >= 0 else below}"
            scale = scale if self.value >= 0 else -scale
        value, (low, high) = scale * self.value, sorted((scale * self.low, scale * self.high))
        digits = _decimal_places(high - low, value)
        # Adding 0.0 turns -0.0 into 0.0.
        shown, lowest, highest = (f"{round(number, digits) + 0.0:.{digits}f}" for number in (value, low, high))
        return f"{shown} {unit} ({lowest} to {highest}){word}".replace("_", " ")


def describe_effect(effect: Effect, component: str, values: Mapping[str, ValueWithInterval], nominal: str) -> str:
    """What the effect is, as half a sentence: "joint 4 has 0.80 Nm (0.79 to 0.81) more dry friction".

    values: by the quantity's name; one that was not found is zero. nominal: what is compared with, "the simulator".
    """
    known = {q.name: values.get(q.name, ValueWithInterval(0.0, 0.0, 0.0)) for q in effect.quantities}
    phrase = effect.sentence_template or _default_template(effect)
    where = describe_component(effect.target, component) if effect.target in ARM_TARGETS else str(effect.target)
    return phrase.format(at=where, nominal=nominal, **known)


def template_fields(phrase: str) -> set[str]:
    """The names of the fields of a phrase."""
    return {name for _, name, _, _ in Formatter().parse(phrase) if name}


def describe_component(kind: EffectTarget, component: str) -> str:
    """Where it is, in words: the arm, joint 4, link 4; a joint of another arm as it is called there."""
    if component == ARM:
        return "the arm"
    number = component.removeprefix("panda_joint")
    if not number.isdigit():
        return component
    return f"{'link' if kind is EffectTarget.LINK else 'joint'} {number}"


def _default_template(effect: Effect) -> str:
    """Of a record without a phrase, somebody's own: its name and its numbers."""
    numbers = ", ".join(
        f"{q.name.replace('_', ' ')} {{{q.name}:{q.unit.replace(' ', '_')}}}" for q in effect.quantities
    )
    return f"{{at}} has {effect.id.replace('_', ' ')}: {numbers}"


def _decimal_places(width: float, value: float) -> int:
    """Decimals at which the half of an interval has its first digit; three digits of the value where there is no interval."""
    size = width / 2 if width > 0 else abs(value) / 100
    return max(0, -floor(log10(size))) if size > 0 else 0

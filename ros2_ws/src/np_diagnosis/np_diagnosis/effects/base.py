"""What an effect is: parameters, and the columns by which they show in the residuals of each stage.

residual(stage) = sum over effects of columns(stage) @ parameters. Parameters are changes against the nominal
simulator, so zero is no effect. What is not linear has a `shape` (a lag, a speed) on a grid of variants; the
competition picks one and `refine` settles it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from np_diagnosis.arm.model import Arm
from np_diagnosis.arm.stages import Drive, Prediction
from np_diagnosis.recordings.signals import Log, Samples


@dataclass(frozen=True, eq=False)
class Context:
    """What effects may look at. drive: None without commands; ripples: orders per revolution found by joint;
    quanta (k,) rad: step of each encoder, 0 where none shows; held (n,) bool: periods of the drive in which the
    last command was held, None without drive; held_share: of the `held_seen` periods in which that could have been
    seen."""

    arm: Arm
    logs: list[Log]
    samples: Samples
    prediction: Prediction
    drive: Drive | None
    transmission: object | None
    ripples: Mapping[int, tuple[int, ...]]
    held: np.ndarray | None
    held_share: float
    quanta: np.ndarray
    held_seen: int = 0


@dataclass(frozen=True)
class Parameter:
    """A change against the nominal simulator, from lower to upper, N(centre, prior^2) before any data.

    least: magnitude up to which it is what any arm has of it, and not worth naming; background: standard
    deviation of what any arm has of it, which no interval can be narrower than.
    """

    name: str
    unit: str
    lower: float
    upper: float
    prior: float
    centre: float = 0.0
    least: float = 0.0
    background: float = 0.0


@dataclass(frozen=True, eq=False)
class Shape:
    """A parameter that columns are not linear in. linear: to first order the effect is proportional to it, so
    that the only coefficient is its share: value times coefficient is the better value. upper: beyond it, it is another
    effect, of the same form."""

    name: str
    unit: str
    value: float
    rebuild: Callable[[float], Effect]
    linear: bool = False
    background: float = 0.0
    least: float = 0.0
    upper: float = np.inf


Columns = Callable[[Context, int], np.ndarray]
MODEL = 0.015  # to which two discretisations of the same law agree: learnt on development cases


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect. columns: stage -> function(context, joint) -> (n, parameters), residual per unit.

    An effect of one joint acts on that joint only; an effect of the whole arm (`is_arm`) shows in every joint
    with the same parameters. variant: what tells it from others of this id, in words. component: of an arm
    effect, the joint it sits at, or "arm"; only_joint: the one joint a variant is meant for, None for all;
    constants: numbers of the variant that a simulator needs besides the parameters. absorbs: nuisance that says
    the same: what the data put into it beyond its usual value belongs to the effect. model: share of a value to
    which the law itself is known, half of a 95 % interval.
    """

    id: str
    parameters: tuple[Parameter, ...]
    columns: Mapping[str, Columns]
    source: str
    variant: str = ""
    shape: Shape | None = None
    is_arm: bool = False
    component: str = "arm"
    only_joint: int | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    absorbs: str = ""
    model: float = MODEL

    @property
    def entry(self) -> dict:
        """This effect in the catalogue: module, model, exciting_experiment, ..."""
        return catalogue()[self.id]

    @property
    def module(self) -> str:
        """Module of the catalogue."""
        return self.entry["module"]

    @property
    def key(self) -> str:
        """Name that tells variants apart."""
        return f"{self.id}[{self.variant}]" if self.variant else self.id


@cache
def catalogue() -> dict[str, dict]:
    """The catalogue by id."""
    return {entry["id"]: entry for entry in _data()["effects"]}


@cache
def equivalence_classes() -> tuple[tuple[frozenset[str], str], ...]:
    """Ids that one data set may not tell apart, and what splits them."""
    return tuple((frozenset(entry["members"]), entry["split_by"]) for entry in _data()["equivalence_classes"])


@cache
def _data() -> dict:
    return yaml.safe_load((files("np_diagnosis") / "data" / "gap_effects.yaml").read_text(encoding="utf-8"))


def stack(*columns: np.ndarray) -> np.ndarray:
    """(n, count) of columns (n,)."""
    return np.column_stack(columns)


NOTHING = 1e-18  # of a value is lost in rounding


def recurrence(decay: np.ndarray, inflow: np.ndarray) -> np.ndarray:
    """x (n,) of x[i] = decay[i] x[i - 1] + inflow[i], x[-1] = 0, in log2 n passes over the whole array.

    Pairs of neighbouring steps are one step, pairs of those another (Hillis and Steele 1986); what is further
    away than the decay reaches is left out.
    """
    decay, x = decay.copy(), inflow.copy()
    reach = 1
    while reach < len(x) and decay[reach:].max() > NOTHING:
        x[reach:] += decay[reach:] * x[:-reach]
        decay[reach:] *= decay[:-reach]
        reach *= 2
    return x

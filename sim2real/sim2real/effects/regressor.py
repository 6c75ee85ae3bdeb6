"""How an effect shows: columns by which its parameters enter the residuals of each stage.

residual(stage) = sum over effects of columns(stage) @ parameters. Parameters are changes against the nominal simulator, so
zero is no effect. What is not linear has a `shape` (a lag, a speed) on a grid of variants: the competition of models picks
one, and its size is settled afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage

MODEL_ERROR = 0.015  # share to which two discretisations of the same law agree: learnt on development cases


@dataclass(frozen=True)
class Parameter:
    """A change against the nominal simulator, from lower to upper, N(centre, prior^2) before any data.

    least: magnitude up to which it is what any arm has of it, and not worth naming. background: standard deviation of what
    any arm has of it, which no interval can be narrower than.
    """

    name: str
    unit: str
    lower: float
    upper: float
    prior: float
    centre: float = 0.0
    least: float = 0.0
    background: float = 0.0


# Of an effect that lies in its shape: how much of the shape's columns is there.
SHARE = Parameter("share", "1", 0.0, 3.0, 1.0)
WHOLE = Parameter("share", "1", 0.7, 1.3, 0.02, 1.0)  # all of it, or it is another shape


@dataclass(frozen=True, eq=False)
class NonlinearParameter:
    """A parameter that columns are not linear in.

    linear: to first order the effect is proportional to it, so that the only coefficient is its share, and value times
    coefficient is the better value. upper: beyond it, it is another effect of the same form.
    """

    name: str
    unit: str
    value: float
    rebuild: Callable[[float], EffectRegressor]
    linear: bool = False
    background: float = 0.0
    least: float = 0.0
    upper: float = np.inf


Columns = Callable[[Context, int], np.ndarray]


@dataclass(frozen=True, eq=False)
class EffectRegressor:
    """One way in which an effect may show in a recording.

    columns: stage -> function(context, joint) -> (n, parameters), residual per unit. An effect of one joint acts on that
    joint only; an effect of the whole arm (`is_arm`) shows in every joint with the same parameters. variant: what tells it
    from other signatures of this id, in words. component: of an arm effect, the joint it sits at, or "arm". only_joint: the
    one joint a variant is meant for, None for all. constants: numbers of the variant that a simulator needs besides the
    parameters. absorbs: the nuisance that says the same: what the data put into it beyond its usual value belongs to the
    effect. model: share of a value to which the law itself is known, half of a 95 % interval. acts: share of the rows in which
    it acts at all, by which it is judged whether it matters: what is rare is small on average.
    """

    id: str
    parameters: tuple[Parameter, ...]
    columns: Mapping[Stage, Columns]
    source: str
    variant: str = ""
    shape: NonlinearParameter | None = None
    is_arm: bool = False
    component: str = "arm"
    only_joint: int | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    absorbs: str = ""
    model: float = MODEL_ERROR
    acts: float = 1.0

    @property
    def key(self) -> str:
        """Name that tells variants apart."""
        return f"{self.id}[{self.variant}]" if self.variant else self.id


def stack(*columns: np.ndarray) -> np.ndarray:
    """(n, count) of columns (n,)."""
    return np.column_stack(columns)

"""How an effect shows: columns by which its parameters enter the residuals of each stage.

residual(stage) = sum over effects of columns(stage) @ parameters. Parameters are changes against the nominal simulator, so
zero is no effect. A `nonlinear` parameter (a lag, a speed) has a grid of variants: the competition of models picks
one, and its size is settled afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage

MODEL_ERROR = 0.015  # relative difference of two discretisations of the same law, from development cases


@dataclass(frozen=True)
class Parameter:
    """A coefficient: a change against the nominal simulator, N(centre, prior^2) before any data, within bounds."""

    name: str
    """Name of the quantity."""
    unit: str
    """Its unit."""
    lower: float
    """Smallest value."""
    upper: float
    """Largest value."""
    prior: float
    """Standard deviation of the prior."""
    centre: float = 0.0
    """Mean of the prior."""
    least: float = 0.0
    """Magnitude up to which it is unit-to-unit variation, and not worth naming."""
    background: float = 0.0
    """Standard deviation of the unit-to-unit variation, which no interval can be narrower than."""
    is_in_whitening: bool = True
    """Whether the noise by which residuals are prewhitened is what its column leaves too."""


SHARE = Parameter("share", "1", 0.0, 3.0, 1.0)
"""Coefficient of an effect with a nonlinear parameter: the fraction of its columns that is there."""
WHOLE = Parameter("share", "1", 0.7, 1.3, 0.02, 1.0)
"""The same where all of it is there, or the nonlinear parameter is another."""


@dataclass(frozen=True, eq=False)
class NonlinearParameter:
    """A parameter that the columns are not linear in; the search uses a grid of it, and it is refined afterwards."""

    name: str
    """Name of the quantity."""
    unit: str
    """Its unit."""
    value: float
    """Its value in this regressor."""
    rebuild: Callable[[float], EffectRegressor]
    """The regressor at another value."""
    linear: bool = False
    """Whether the effect is proportional to it to first order, so that value times coefficient is the better value."""
    background: float = 0.0
    """As in `Parameter`."""
    least: float = 0.0
    """As in `Parameter`."""
    upper: float = np.inf
    """Largest value; beyond it the cause is another one of the same form."""
    rivals: tuple[Callable[[float], EffectRegressor], ...] = ()
    """`rebuild` under other assumptions of the law that a recording hardly tests: the interval covers all that fit as well."""


Columns = Callable[[Context, int], np.ndarray]


@dataclass(frozen=True, eq=False)
class EffectRegressor:
    """One way in which an effect may show in a recording.

    An effect of one joint acts on that joint only. An effect of the whole arm shows in every joint with the same parameters.
    """

    id: str
    """Id of the effect."""
    parameters: tuple[Parameter, ...]
    """Coefficients of the columns."""
    columns: Mapping[Stage, Columns]
    """Stage -> function(context, joint) -> (n, parameters), residual per unit."""
    source: str
    """Where the law is from."""
    variant: str = ""
    """What distinguishes it from other regressors of this id, in words."""
    nonlinear: NonlinearParameter | None = None
    """The parameter in which the columns are not linear."""
    is_arm: bool = False
    """Whether it is of the whole arm."""
    component: str = "arm"
    """Of an effect of the arm, the joint that it sits at, or "arm"."""
    only_joint: int | None = None
    """The one joint that a variant is meant for; None: all."""
    constants: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the variant that a simulator needs besides the parameters."""
    absorbs: str = ""
    """Name of the nuisance that has the same columns: what exceeds its usual value belongs to the effect."""
    model: float = MODEL_ERROR
    """Half of a 95 % interval of the law itself, as a fraction of the value."""
    acts: float = 1.0
    """Fraction of the rows in which it acts, by which a rare effect is judged."""

    @property
    def key(self) -> str:
        """Name that distinguishes variants."""
        return f"{self.id}[{self.variant}]" if self.variant else self.id


def stack(*columns: np.ndarray) -> np.ndarray:
    """(n, count) of columns (n,)."""
    return np.column_stack(columns)

"""One result of the diagnosis of an arm: an effect at a component, how large it is and how sure."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.checks.held_out import EffectTrial
from sim2real.effects.regressor import EffectRegressor
from sim2real.inference.estimates import Estimate
from sim2real.thresholds import THRESHOLDS

VERDICT = THRESHOLDS.verdict


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that the chosen model holds (`is_chosen`), or that another probable model holds instead."""

    effect: EffectRegressor
    """The effect, its nonlinear parameter refined."""
    component: str
    """A joint's name, or "arm"."""
    probability: float
    """Posterior probability of the effect at this component, over all models that were scored."""
    parameters: dict[str, Estimate]
    """Estimates with 95 % intervals, by the parameter's name."""
    shrink: float
    """Fraction by which the effect alone shrinks the held-out gap of the joints that it acts on."""
    equivalent_to: tuple[str, ...]
    """Ids of effects that these recordings cannot distinguish from it."""
    is_chosen: bool
    """Whether the chosen model holds it."""
    energy: float
    """Mean square torque that it removes, Nm^2."""
    generalised_by: tuple[str, ...] = ()
    """Ids of effects of which it is a special case (`ranking.generalisations`); they do not contradict it."""
    generalised_probability: float = 0.0
    """Sum of the probabilities of `generalised_by`."""
    held_out: EffectTrial | None = None
    """What it does on held-out motion; None where there is none, or the chosen model does not hold it."""

    @property
    def is_shown_to_help(self) -> bool:
        """Whether the model predicts held-out motion surely better with it than without it."""
        return self.held_out is not None and self.held_out.is_shown and self.held_out.helps

    @property
    def class_probability(self) -> float:
        """Probability of this effect, or of one of which it is a special case."""
        return min(1.0, self.probability + self.generalised_probability)

    @property
    def competing_effects(self) -> tuple[str, ...]:
        """The effects of `equivalent_to` that contradict it: its confusion set."""
        return tuple(name for name in self.equivalent_to if name not in self.generalised_by)

    @property
    def is_open(self) -> bool:
        """Whether another effect may as well be the cause."""
        return self.class_probability < VERDICT.certain or bool(self.competing_effects)

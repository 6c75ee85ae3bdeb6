"""Effects that all joints show with one set of parameters: estimated before the joints compete."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.competition import LEAST_GAIN, T95, Competition, compete, standard_error
from np_diagnosis.design import NUISANCES, Design, Sums

CONTEXT = ("asymmetric_coulomb_friction", "asymmetric_viscous_friction")


@dataclass(frozen=True, eq=False)
class ArmOption:
    """An effect of the arm, or None; parameters (blocks, k) of each training set; what joints then need."""

    key: str | None
    parameters: np.ndarray
    joints: list[Competition]

    @property
    def density(self) -> np.ndarray:
        """Log predictive density of each block, all joints."""
        return np.sum([c.chosen.score.density for c in self.joints], axis=0)

    @property
    def size(self) -> int:
        """Effects in use."""
        return (self.key is not None) + sum(len(c.chosen.keys) for c in self.joints)

    @property
    def rmse(self) -> float:
        """Held-out RMSE averaged over the joints, Nm."""
        return float(np.mean([c.rmse(c.chosen) for c in self.joints]))


def arm_options(designs: list[Design]) -> list[ArmOption]:
    """Every option, without any first; the joints compete with single effects only."""
    none = ArmOption(None, np.zeros((0, 0)), [compete(d, pairs=False) for d in designs])
    weights = [1 / (c.chosen.score.fit.variance.mean() * d.correlation) for c, d in zip(none.joints, designs)]
    options = [none]
    for key, effect in designs[0].effects.items():
        if effect.is_arm:
            parameters = estimate(designs, [d.train for d in designs], key, weights)
            options.append(
                ArmOption(
                    key, parameters, [compete(d, *shifted(d, key, parameters), pairs=False) for d in designs]
                )
            )
    return options


def pick(options: list[ArmOption]) -> ArmOption:
    """The option that predicts clearly better than none, or as well with at least two effects fewer."""
    none, chosen = options[0], options[0]
    for option in options[1:]:
        difference = option.density - none.density
        error = T95 * standard_error(difference)
        is_better = difference.sum() > error and option.rmse < (1 - LEAST_GAIN) * none.rmse
        is_simpler = difference.sum() > -error and option.size <= none.size - 2
        if (is_better or is_simpler) and (chosen is none or option.density.sum() > chosen.density.sum()):
            chosen = option
    return chosen


def estimate(designs: list[Design], sums: list[Sums], key: str, weights: list[float]) -> np.ndarray:
    """Parameters (m, k) of an arm effect from all joints, for each of the m sums.

    Each joint may explain what it can by friction of its own first; weights: 1 / variance of each joint.
    """
    columns = designs[0].columns[key]
    prior = designs[0].prior[columns]
    normal, moment = np.diag(prior**-2)[None], 0.0
    for design, part, weight in zip(designs, sums, weights):
        own = np.concatenate([np.arange(NUISANCES), *(design.columns[name] for name in CONTEXT)])
        gram = part.gram
        regular = gram[:, own[:, None], own] + np.diag(design.prior[own] ** -2) / weight
        both = np.concatenate([columns, [-1]])
        cross = gram[:, own[:, None], both]
        left = gram[:, columns[:, None], both] - cross[:, :, :-1].transpose(0, 2, 1) @ np.linalg.solve(
            regular, cross
        )
        normal = normal + weight * left[:, :, :-1]
        moment = moment + weight * left[:, :, -1]
    solved = np.linalg.solve(normal, moment[..., None])[..., 0]
    return np.clip(solved, designs[0].lower[columns], designs[0].upper[columns])


def shifted(design: Design, key: str | None, parameters: np.ndarray) -> tuple[Sums, Sums]:
    """Training and test sums of a joint once an arm effect is taken into account."""
    if key is None:
        return design.train, design.test
    columns = design.columns[key]
    return design.train.shifted(columns, parameters), design.test.shifted(columns, parameters)

"""The next experiment: which motion would split what a recording leaves open, and how probably.

For an ambiguity there are the chosen model and its rivals. An experiment's planned motion (`forecast`) gives
what each would predict there, with the uncertainty of its parameters after what has been recorded, and the noise
found. So the log Bayes factor that the experiment would give can be drawn in advance, with the one model true
or the other (expected information of a linear Gaussian design: Chaloner and Verdinelli, Stat. Sci. 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.catalogue import equivalence_classes
from sim2real.excitation.ambiguity import Ambiguity, joints_affected
from sim2real.excitation.planned_recordings import plan_cells
from sim2real.excitation.suite import make_experiment
from sim2real.finding import Finding
from sim2real.inference.fit import fit_parameters, parameter_indices
from sim2real.inference.regression import RegressionProblem
from sim2real.inference.residual_cells import ResidualCell
from sim2real.inference.search import ModelSearch
from sim2real.thresholds import THRESHOLDS

POWER = THRESHOLDS.power

NONE = "none of them can"
UNLIKELY = "none of them is likely to"

EXPERIMENTS = (
    "triangle_slow",
    "triangle_medium",
    "triangle_fast",
    "microstrokes",
    "dwell",
    "second_dwell",
    "third_dwell",
    "low_damping",
    "long_reference",
    "long_second",
    "long_third",
    "long_slow",
)

DRAWS = 200  # of the log Bayes factor of an experiment
LARGEST_LOG_ODDS = 30.0  # nats, beyond which odds are certainty
"""Tried for every joint; with them the joint's own sinusoid and sweep, and chirps of its half of the arm."""


@dataclass(frozen=True)
class ExperimentPower:
    """The expected evidence of an experiment."""

    name: str
    """Name of the experiment."""
    duration: float
    """s."""
    probability: float
    """That the true model leads all that it can be distinguished from by `POWER.decisive` nats in the end."""
    nats: float
    """Expected log Bayes factor against the nearest of them."""

    @property
    def sigma(self) -> float:
        """Standard deviations by which the two predictions lie apart."""
        return float(np.sqrt(2 * max(self.nats, 0.0)))


def candidate_experiments(joints: Sequence[int]) -> tuple[str, ...]:
    """Experiments worth planning for what shows in these joints, by number."""
    own = [f"{kind}_{j + 1}" for j in joints for kind in ("sinusoid", "sweep")] if len(joints) <= 2 else []
    halves = {"odd" if j % 2 == 0 else "even" for j in joints}
    return (
        *EXPERIMENTS,
        *own,
        *(f"{kind}_{half}" for half in sorted(halves) for kind in ("chirp", "long_chirp")),
    )


def predict_powers(search: ModelSearch, open_question: Ambiguity, names: Sequence[str]) -> list[list[ExperimentPower]]:
    """For each rival, the expected evidence of each experiment between it and the chosen model."""
    design, models = search.design, open_question.models
    here = [
        m
        for m in sorted({m for s in models for m in s.members})
        if set(joints_affected(search, m)) & set(open_question.joints)
    ]
    cells = [c for c in design.cells if c.joint in open_question.joints]
    planned = plan_cells(design, names, here, open_question.joints)
    nuisance = np.concatenate([design.nuisances[j] for j in open_question.joints])
    beliefs = [_Belief.of(design, cells, nuisance, [m for m in s.members if m in here]) for s in models]
    ids = np.unique(np.concatenate([b.ids for b in beliefs]))
    duration = [make_experiment(name).duration for name in names]
    table = []
    for rival, other in zip(models[1:], beliefs[1:]):
        lead = float(np.clip(models[0].total - rival.total, -POWER.known, POWER.known))
        log_odds = search.value(rival) - search.value(models[0])
        probability = 1 / (1 + np.exp(np.clip(log_odds, -LARGEST_LOG_ODDS, LARGEST_LOG_ODDS)))
        row = []
        for number, name in enumerate(names):
            normal = _normal_matrix(cells, planned, beliefs[0].variance, ids, number)
            one, two = (
                _draw_log_bayes_factors(normal, ids, *pair) for pair in ((beliefs[0], other), (other, beliefs[0]))
            )
            found, missed = np.mean(lead + one > POWER.decisive), np.mean(two - lead > POWER.decisive)
            right = probability * found + (1 - probability) * missed
            row.append(ExperimentPower(name, duration[number], float(right), float(min(one.mean(), two.mean()))))
        table.append(row)
    return table


def choose_next_experiment(diagnosis: Diagnosis, question: tuple[Finding, Ambiguity] | None) -> dict | None:
    """What would settle a question, as in the report; None where nothing would.

    For another arm than the Panda, whose excitation this package does not plan: the catalogue's text.
    """
    if question is None:
        return None
    if diagnosis.context.arm.joints != NOMINAL.joints:
        return _catalogue_experiment(question[0])
    return _rank_experiments(diagnosis.search, question[1])


def _catalogue_experiment(finding: Finding) -> dict:
    ids = {finding.effect.id, *finding.equivalent_to}
    split = next((text for members, text in equivalence_classes() if len(members & ids) > 1), None)
    return {
        "name": split or ARM_EFFECTS[finding.effect.id].entry["exciting_experiment"],
        "separates": sorted(ids),
        "component": finding.component,
    }


def _rank_experiments(search: ModelSearch, question: Ambiguity) -> dict:
    names = candidate_experiments(question.joints)
    table = predict_powers(search, question, names)
    text = [" + ".join(parts) for parts in question.names]
    can = [max(p.probability for p in row) >= POWER.least for row in table]
    weights = (
        np.array(
            [
                np.exp(np.clip(search.value(s) - search.value(question.models[0]), -POWER.known, 0.0))
                for s in question.models[1:]
            ]
        )
        * can
    )
    answer = {
        "separates": text,
        "component": question.component,
        "expected_sigma": 0.0,
        "probability": 0.0,
        "cannot_separate": [t for t, c in zip(text[1:], can) if not c],
        "ranked": [],
    }
    if not any(can):
        return {"name": NONE, **answer}
    weights = weights / weights.sum()
    columns = list(zip(*table))
    ranked = [
        ExperimentPower(
            column[0].name,
            column[0].duration,
            float(sum(w * p.probability for w, p in zip(weights, column))),
            min(p.nats for p, c in zip(column, can) if c),
        )
        for column in columns
    ]
    top = max(p.probability for p in ranked)
    best = min((p for p in ranked if p.probability >= top - POWER.worth), key=lambda p: p.duration)
    ranked.sort(key=lambda p: -p.probability)
    is_likely = best.probability >= POWER.likely
    command = {"command": f"ros2 run np_diagnosis excite --only {best.name} --out BAG"} if is_likely else {}
    return {
        "name": best.name if is_likely else UNLIKELY,
        **answer,
        "separates": [t for t, c in zip(text, [True, *can]) if c],
        "expected_sigma": round(best.sigma, 2),
        "probability": round(best.probability, 3),
        "duration_s": round(best.duration, 1),
        **command,
        "ranked": [
            {
                "name": p.name,
                "duration_s": round(p.duration, 1),
                "probability": round(p.probability, 3),
                "expected_sigma": round(p.sigma, 2),
            }
            for p in ranked[: POWER.ranked]
        ],
    }


@dataclass(frozen=True, eq=False)
class _Belief:
    """A model after the recording: N(mean, covariance) of p parameters."""

    ids: np.ndarray
    """(p,), numbers of the parameters."""
    mean: np.ndarray
    """(p,)."""
    covariance: np.ndarray
    """(p, p)."""
    variance: dict[tuple[str, int], float]
    """Noise variance by cell."""

    @classmethod
    def of(
        cls, design: RegressionProblem, cells: Sequence[ResidualCell], nuisance: np.ndarray, members: Sequence[int]
    ) -> _Belief:
        ids = np.concatenate([nuisance, *(design.candidates[m].ids for m in members)])
        fit = fit_parameters(
            cells,
            [c.test.sum(axis=0)[None] for c in cells],
            [c.test_rows.sum()[None] for c in cells],
            ids,
            design.parameters,
        )
        return cls(
            ids,
            fit.parameters[0],
            fit.covariance[0],
            {(c.name, c.joint): float(v[0]) for c, v in zip(cells, fit.variance)},
        )


def _normal_matrix(cells, planned, variance, ids, number) -> np.ndarray:
    """Sum (p, p) of squares and products of all parameters' columns in one experiment, over the noise."""
    normal = np.zeros((len(ids), len(ids)))
    for cell in planned:
        columns, at = parameter_indices(cell, ids)
        gram = cell.test[number][np.ix_(columns, columns)]
        normal[np.ix_(at, at)] += gram / variance[cell.name, cell.joint]
    return normal


def _draw_log_bayes_factors(normal: np.ndarray, ids: np.ndarray, true: _Belief, other: _Belief) -> np.ndarray:
    """Log Bayes factors (draws,) nats for the true model in experiments drawn from what it predicts."""
    rng = np.random.default_rng(0)
    mine = np.searchsorted(ids, true.ids)
    parameters = rng.multivariate_normal(true.mean, true.covariance, DRAWS, method="eigh")
    values, vectors = np.linalg.eigh(normal)
    noise = rng.normal(size=(DRAWS, len(ids))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    moments = parameters @ normal[mine] + noise
    return _log_evidence(normal, moments, ids, true) - _log_evidence(normal, moments, ids, other)


def _log_evidence(normal: np.ndarray, moments: np.ndarray, ids: np.ndarray, belief: _Belief) -> np.ndarray:
    """Log density (draws,) of data with these moments (draws, p), up to what all models share."""
    at = np.searchsorted(ids, belief.ids)
    precision = np.linalg.inv(belief.covariance)
    posterior, n = precision + normal[np.ix_(at, at)], moments[:, at]
    pull = n + precision @ belief.mean
    shrunk = np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(precision)[1]
    return 0.5 * (
        (pull * np.linalg.solve(posterior, pull.T).T).sum(axis=1) - belief.mean @ precision @ belief.mean - shrunk
    )

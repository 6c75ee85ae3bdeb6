"""From samples to verdicts: where the gap is, which effects explain it, how far they shrink it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from np_description.panda import NOMINAL, PandaModel

from np_diagnosis.arm import ArmOption, arm_options, estimate, pick, shifted
from np_diagnosis.competition import (
    DRAWS,
    LEAST_GAIN,
    T95,
    VISIBLE,
    Competition,
    Structure,
    compete,
    standard_error,
)
from np_diagnosis.design import Design, Sums, make_blocks, make_design
from np_diagnosis.effects import Effect
from np_diagnosis.fit import fit
from np_diagnosis.floor import repeatability
from np_diagnosis.nominal import Prediction, predict
from np_diagnosis.signals import Samples

LEAST_BLOCKS = 5  # in which a joint must move to be judged
MATERIAL = 0.002  # of the torque limit: an unexplained residual below is no gap
EXPLAINED = 0.8  # of the gap's energy above the floor: what explains less is no explanation
CERTAIN = 0.8  # probability of an effect from which on it counts as identified
POSSIBLE = 0.1  # probability from which on an effect is named as an alternative
BOOTSTRAPS = 300
# Structures with the same columns while a joint moves.
SAME_WHILE_MOVING = ({"asymmetric_coulomb_friction"}, {"coulomb_friction", "torque_offset"})


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """An effect at a component (joint, or "arm"): probability, parameters by name, the share by which it
    alone shrinks the held-out RMSE there, the ids that these data cannot tell from it, and whether it is taken
    into account in `after`."""

    effect: Effect
    component: str
    probability: float
    parameters: dict[str, Estimate]
    shrink: float
    equivalent_to: tuple[str, ...]
    is_chosen: bool


@dataclass(frozen=True, eq=False)
class JointResult:
    """One joint: verdict, held-out RMSE Nm before and after and with the arm's effect only, floor Nm.

    verdict: no_gap, identified, ambiguous, unexplained, or not_excited for a joint that hardly moved.
    is_floor_measured: else the floor is a lower bound. delay: s by which torque lags motion in the stamps.
    residual_before, residual_after (n,) Nm, the latter held out; NaN where nothing was predicted.
    """

    joint: str
    verdict: str
    before: float
    with_arm: float
    after: float
    floor: float
    is_floor_measured: bool
    delay: float
    findings: tuple[Finding, ...]
    residual_before: np.ndarray
    residual_after: np.ndarray


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer. before, after, floor: Nm, averaged over the joints that moved; shrink with interval."""

    verdict: str
    joints: tuple[JointResult, ...]
    arm: tuple[Finding, ...]
    before: float
    after: float
    floor: float
    shrink: float
    shrink_interval: tuple[float, float]
    blocks: int
    samples: Samples
    prediction: Prediction


def diagnose(samples: Samples, panda: PandaModel = NOMINAL, seed: int = 0) -> Diagnosis:
    """Compare the samples with the nominal arm. Raises ValueError where they are too short."""
    rng = np.random.default_rng(seed)
    prediction = predict(samples, panda)
    blocks = make_blocks(samples)
    designs = [
        make_design(samples, prediction, j, blocks, panda.torque_limit[j]) for j in range(len(panda.joints))
    ]
    floor, is_measured = repeatability(samples, samples.torque - prediction.total)
    options = arm_options(designs)
    option = pick(options)
    results, squares = [], []
    weights = rng.multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)), BOOTSTRAPS)
    arm_draws = _arm_draws(designs, option, weights)
    arm = _arm_findings(options, option, arm_draws, designs, rng)
    is_arm_certain = len(arm) == 1
    for design, plain in zip(designs, options[0].joints):
        competition = compete(design, *shifted(design, option.key, option.parameters), seed=seed)
        joint = design.joint
        result, square = _judge(
            design,
            plain,
            competition,
            option,
            is_arm_certain,
            weights,
            arm_draws,
            panda,
            blocks,
            max(floor[joint], 1e-9),
            bool(is_measured[joint]),
        )
        results.append(result)
        squares.append(square)
    moved = [r for r in results if r.verdict != "not_excited"]
    if not moved:
        raise ValueError(f"expected a joint that moves in {LEAST_BLOCKS} blocks of the recording, got none")
    before, after, lowest = (
        float(np.mean([getattr(r, name) for r in moved])) for name in ("before", "after", "floor")
    )
    shrink = 1 - after / before
    draws = _shrink_draws([s for s, r in zip(squares, results) if r.verdict != "not_excited"], weights)
    half = T95 * draws.std()
    return Diagnosis(
        _overall(results, arm),
        tuple(results),
        arm,
        before,
        after,
        lowest,
        shrink,
        (max(-1.0, shrink - half), min(1.0, shrink + half)),
        len(blocks),
        samples,
        prediction,
    )


def _judge(
    design: Design,
    plain: Competition,
    competition: Competition,
    option: ArmOption,
    is_arm_certain: bool,
    weights,
    arm_draws,
    panda: PandaModel,
    blocks,
    floor: float,
    is_measured: bool,
):
    """Verdict of one joint, and its squared errors (before, after) and rows by block for the bootstrap."""
    name = panda.joints[design.joint]
    before, with_arm = plain.rmse(plain.null), competition.rmse(competition.null)
    chosen, limit = competition.chosen, panda.torque_limit[design.joint]
    after = competition.rmse(chosen)
    floor = min(floor, before, after)
    findings = _findings(competition, chosen, name, weights, option, arm_draws)
    reducible = before**2 - floor**2
    removed = before**2 - after**2
    is_explained = after < (1 - LEAST_GAIN) * before and removed > EXPLAINED * reducible
    if design.used.sum() < LEAST_BLOCKS:
        verdict, chosen = "not_excited", competition.null
    elif not is_explained:
        is_gap = reducible > max((MATERIAL * limit) ** 2, floor**2 if is_measured else (3 * floor) ** 2)
        verdict, chosen = ("unexplained" if is_gap else "no_gap"), competition.null
    elif removed < (VISIBLE * limit) ** 2:
        verdict, chosen = "no_gap", competition.null
    else:
        certain = (
            is_arm_certain
            if chosen is competition.null
            else all(f.probability >= CERTAIN and not f.equivalent_to for f in findings if f.is_chosen)
        )
        verdict = "identified" if certain else "ambiguous"
    if verdict in ("no_gap", "not_excited"):
        findings = ()
    elif chosen is competition.null:
        findings = tuple(replace(f, is_chosen=False) for f in findings if verdict == "unexplained")
    residual = np.full(len(design.residual), np.nan)
    for b in np.flatnonzero(design.used):
        rows = blocks[b].rows[design.moving[blocks[b].rows]]
        residual[rows] = design.residual[rows] - (
            design.matrix[rows][:, chosen.columns] @ chosen.score.fit.parameters[b]
        )
        if option.key is not None:
            residual[rows] -= design.matrix[rows][:, design.columns[option.key]] @ option.parameters[b]
    delay = float(chosen.score.fit.parameters[:, 0].mean())
    result = JointResult(
        name,
        verdict,
        before,
        with_arm,
        competition.rmse(chosen),
        floor,
        is_measured,
        delay,
        findings,
        np.where(design.moving, design.residual, np.nan),
        residual,
    )
    return result, (
        plain.null.score.squares,
        chosen.score.squares,
        np.where(design.used, design.test.rows, 0),
    )


def _findings(
    competition: Competition, chosen: Structure, joint: str, weights, option: ArmOption, arm_draws
) -> tuple[Finding, ...]:
    """The chosen effects, then alternatives by probability; of variants of one effect the best."""
    design = competition.design
    singles = {s.keys[0]: s for s in competition.structures if len(s.keys) == 1}
    best: dict[str, str] = {}
    for key, single in sorted(singles.items(), key=lambda item: item[1].total):
        best[design.effects[key].id] = key
    best |= {design.effects[key].id: key for key in chosen.keys}
    ids = {design.effects[key].id for key in chosen.keys}
    null = competition.rmse(competition.null)
    findings = []
    for effect, key in best.items():
        probability = competition.effect_probability(effect)
        is_chosen = key in chosen.keys
        if not is_chosen and probability < POSSIBLE:
            continue
        structure = chosen if is_chosen else singles[key]
        equivalent = set().union(
            *(other for other in SAME_WHILE_MOVING if is_chosen and ids in SAME_WHILE_MOVING and other != ids)
        )
        if is_chosen and probability < CERTAIN:
            equivalent |= {
                other
                for other in best
                if other not in ids and competition.effect_probability(other) >= POSSIBLE
            }
        findings.append(
            Finding(
                design.effects[key],
                joint,
                probability,
                _estimates(competition, structure, key, weights, option, arm_draws),
                1 - competition.rmse(singles[key]) / null,
                tuple(sorted(equivalent)),
                is_chosen,
            )
        )
    return tuple(sorted(findings, key=lambda f: (not f.is_chosen, -f.probability)))


def _estimates(competition: Competition, structure, key: str, weights, option: ArmOption, arm_draws):
    """Values from all blocks; intervals from the bootstrap of blocks, never narrower than the posterior."""
    design = competition.design
    draws = _resampled(design, weights)
    whole = _resampled(design, np.ones((1, weights.shape[1]), int))
    if option.key is not None:
        columns = design.columns[option.key]
        draws, whole = draws.shifted(columns, arm_draws[1:]), whole.shifted(columns, arm_draws[:1])
    resampled, fitted = fit(draws, structure.columns, design), fit(whole, structure.columns, design)
    posterior = np.sqrt(np.diagonal(fitted.covariance[0]))
    estimates = {}
    for parameter, column in zip(design.effects[key].parameters, design.columns[key]):
        i = int(np.flatnonzero(structure.columns == column)[0])
        value = float(fitted.parameters[0, i])
        half = T95 * max(float(resampled.parameters[:, i].std()), float(posterior[i]))
        estimates[parameter.name] = Estimate(value, value - half, value + half, parameter.unit)
    return estimates


def _resampled(design: Design, weights: np.ndarray) -> Sums:
    return Sums(np.tensordot(weights, design.test.gram, 1), weights @ design.test.rows)


def _arm_draws(designs: list[Design], option: ArmOption, weights: np.ndarray) -> np.ndarray | None:
    """Parameters of the arm's effect: from all blocks in row 0, then from each bootstrap."""
    if option.key is None:
        return None
    every = np.vstack([np.ones(weights.shape[1], int), weights])
    precision = [
        1 / (c.chosen.score.fit.variance.mean() * d.correlation) for c, d in zip(option.joints, designs)
    ]
    return estimate(designs, [_resampled(d, every) for d in designs], option.key, precision)


def _arm_findings(options: list[ArmOption], option: ArmOption, draws, designs: list[Design], rng):
    if option.key is None:
        return ()
    density = np.array([o.density for o in options])
    logits = rng.dirichlet(np.ones(density.shape[1]), DRAWS) * density.shape[1] @ density.T
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    probability = (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)
    findings = []
    for o, p in zip(options, probability):
        difference = option.density - o.density
        rival = o.key is not None and difference.sum() <= T95 * standard_error(difference)
        if o is not option and not (rival and p >= POSSIBLE):
            continue
        effect = designs[0].effects[o.key]
        own = draws if o is option else np.vstack([o.parameters.mean(axis=0), o.parameters])
        half = T95 * own[1:].std(axis=0)
        parameters = {
            q.name: Estimate(float(v), float(v - h), float(v + h), q.unit)
            for q, v, h in zip(effect.parameters, own[0], half)
        }
        findings.append(
            Finding(
                effect, effect.component, float(p), parameters, 1 - o.rmse / options[0].rmse, (), o is option
            )
        )
    rivals = tuple(
        sorted(
            {
                f.effect.id
                for f in findings
                if not f.is_chosen and f.effect.id != designs[0].effects[option.key].id
            }
        )
    )
    return tuple(
        replace(f, equivalent_to=rivals if f.is_chosen else ())
        for f in sorted(findings, key=lambda f: (not f.is_chosen, -f.probability))
    )


def _shrink_draws(squares, weights: np.ndarray) -> np.ndarray:
    """Shrink of the averaged RMSE in each bootstrap of the blocks."""
    before, after = 0.0, 0.0
    for old, new, rows in squares:
        count = np.maximum(weights @ rows, 1)
        before = before + np.sqrt(weights @ old / count)
        after = after + np.sqrt(weights @ new / count)
    return 1 - after / np.maximum(before, 1e-12)


def _overall(results: list[JointResult], arm: tuple[Finding, ...]) -> str:
    """The verdict that holds most of the gap's energy above the floor."""
    energy: dict[str, float] = {}
    for r in results:
        if r.verdict not in ("no_gap", "not_excited"):
            energy[r.verdict] = energy.get(r.verdict, 0.0) + r.before**2 - r.floor**2
    if not energy:
        return "no_gap"
    if energy.get("unexplained", 0.0) > 0.5 * sum(energy.values()):
        return "unexplained"
    is_ambiguous = any(not f.is_chosen for f in arm) or energy.get("ambiguous", 0.0) > energy.get(
        "identified", 0.0
    )
    return "ambiguous" if is_ambiguous else "identified"

"""The camera stage: which of camera, lens, table, object and detector explains where corners of the resting object are seen.

Hypotheses of up to three effects compete by their evidence, integrated over all numbers (`sim2real.task.camera.fit`). Residuals larger than a
detector's error, or with a pattern, are unexplained. Numbers that the recording does not narrow are listed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t as student

from np_description.camera import CAMERA, Camera
from sim2real.effects.sentences import ValueWithInterval
from sim2real.recordings.reading import ContractViolation
from sim2real.task.camera.checks import HeldOutPrediction, corner_distances, find_residual_patterns, held_out_gain
from sim2real.task.camera.fit import CameraFit, Prior, evaluate_at, fit_scene
from sim2real.task.camera.flat_pose import fit_flat_pose
from sim2real.task.camera.model import CameraScene, make_scene
from sim2real.task.camera.parameters import BY_NAME, EFFECTS, GAP, NAMES, PARAMETERS, USUAL
from sim2real.task.camera.rest_poses import RestPose, distinct_rest_poses
from sim2real.task.hypotheses import (
    INDISTINGUISHABLE_LOG_BAYES_FACTOR,
    N_EQUALLY_LIKELY_CANDIDATES,
    Effects,
    Hypothesis,
    TaskFinding,
    select_effects,
    verdict_of,
)
from sim2real.thresholds import THRESHOLDS

COMPARISON = THRESHOLDS.camera_comparison


@dataclass(frozen=True)
class CameraDiagnosis:
    """What explains where corners of the resting object are seen."""

    verdict: str
    """no_gap, identified, ambiguous, unexplained or undetermined."""
    places: int
    """Rest poses that count."""
    left_out: tuple[str, ...]
    """Effects of rest poses at which the object does not lie flat."""
    off: float | None = None
    """Median distance px of a corner from its nominal place."""
    findings: tuple[TaskFinding, ...] = ()
    """The effects of the best hypothesis."""
    gains: dict[str, float] = field(default_factory=dict)
    """Log Bayes factor (nats) of each effect alone."""
    bounds: dict[str, ValueWithInterval] = field(default_factory=dict)
    """Every number with its 95 % interval if its effect were off too."""
    unidentifiable: tuple[str, ...] = ()
    """Numbers that the recording does not narrow."""
    scatter: tuple[float, float] | None = None
    """Error px of a corner in a view that the best hypothesis leaves, and that the nominal set-up leaves."""
    abstention_reason: str = ""
    """Why the stage abstains, or what the best hypothesis does not explain."""
    held_out: HeldOutPrediction | None = None
    """What the best hypothesis predicts at rest poses that it was not fitted to."""
    scene: CameraScene | None = field(default=None, compare=False)
    """Rest poses as arrays; None where there are too few."""
    fit: CameraFit | None = field(default=None, compare=False)
    """Fit of the best hypothesis."""
    nominal: CameraFit | None = field(default=None, compare=False)
    """Fit without any gap."""


def diagnose_camera(places: Sequence[RestPose], camera: Camera = CAMERA) -> CameraDiagnosis:
    """Of places at which the object rested, each of which counts once. camera: the nominal one.

    Raises ContractViolation without a place.
    """
    if not places:
        raise ContractViolation("expected places at which the object rests in the picture, got none")
    places = distinct_rest_poses(places)
    fits = [fit_flat_pose(place, camera) for place in places]
    flat = np.array([one.is_flat for one in fits])
    left_out = tuple(place.name for place, is_flat in zip(places, flat) if not is_flat)
    if flat.mean() < COMPARISON.flat:
        off = np.array([one.off for one in fits])
        errors = f"{np.median(off[np.isfinite(off)]):.0f} px off" if np.isfinite(off).any() else "measured as tilted"
        reason = f"at {len(left_out)} of {len(places)} places the corners are of no {_size(places[0])} that lies flat ({errors})"
        return CameraDiagnosis("unexplained", int(flat.sum()), left_out, abstention_reason=reason)
    flat_places = [(p, w) for p, w, is_flat in zip(places, fits, flat) if is_flat]
    scene = make_scene([p for p, _ in flat_places], [(w.face, w.surface) for _, w in flat_places], camera)
    models = _CameraModels(scene, np.array([w.pose for _, w in flat_places]))
    nominal = models.of(frozenset())
    at_nominal = evaluate_at(scene, np.zeros(len(NAMES)), nominal.poses, nominal.scatter)
    off = float(np.median(corner_distances(scene, at_nominal, models.start)))
    shared = {"places": len(flat_places), "left_out": left_out, "off": off, "scene": scene, "nominal": nominal}
    if reason := _insufficient(scene):
        return CameraDiagnosis("undetermined", **shared, abstention_reason=reason, fit=nominal, unidentifiable=NAMES)
    chosen = select_effects(EFFECTS, models.value, COMPARISON.most)
    best = models.of(chosen)
    findings = tuple(
        sorted((_finding(models, chosen, effect) for effect in chosen), key=lambda one: -one.log_bayes_factor)
    )
    bounds = _bounds(models, chosen)
    reason = "; ".join(filter(None, (_strain(best, chosen), find_residual_patterns(scene, best, models.prior(chosen)))))
    if reason:
        verdict = "unexplained"
    elif findings:
        verdict = verdict_of(findings)
    else:
        verdict = "undetermined" if len(bounds["unidentifiable"]) > COMPARISON.blind * len(NAMES) else "no_gap"
        hidden = f"{len(bounds['unidentifiable'])} of {len(NAMES)} numbers could be off and would not show in it"
        reason = "" if verdict == "no_gap" else hidden
    return CameraDiagnosis(
        verdict,
        **shared,
        **bounds,
        findings=findings,
        gains={name: models.gain(frozenset([name])) for name in EFFECTS},
        scatter=(best.scatter, nominal.scatter),
        abstention_reason=reason,
        held_out=held_out_gain(scene, best, models.prior(chosen), models.start),
        fit=best,
    )


class _CameraModels:
    """Fits of one scene by the effects that are gaps in them, each made once."""

    def __init__(self, scene: CameraScene, start: np.ndarray) -> None:
        self._scene, self.start = scene, start
        self._made: dict[Effects, CameraFit] = {}

    def prior(self, names: Effects) -> Prior:
        """What is known beforehand where these effects are gaps, and all else is as usual."""
        gap = np.zeros(len(NAMES), bool)
        for name in names:
            gap[EFFECTS[name].numbers] = True
        return Prior(np.where(gap, np.hypot(USUAL, GAP), USUAL), gap, np.ones(len(NAMES), bool))

    def of(self, names: Effects) -> CameraFit:
        """The fit with these effects as gaps."""
        if names not in self._made:
            first = min((n for n in self._made if n < names), key=lambda n: self._made[n].cost, default=None)
            self._made[names] = fit_scene(self._scene, self.prior(names), self.start)
            if first is not None:  # a search from another model's end may find what one from the start does not
                again = fit_scene(self._scene, self.prior(names), self.start, first=self._made[first])
                self._made[names] = max(self._made[names], again, key=lambda one: one.evidence)
        return self._made[names]

    def gain(self, names: Effects) -> float:
        """Nats of the evidence beyond that of no gap."""
        return self.of(names).evidence - self.of(frozenset()).evidence

    def value(self, names: Effects) -> float:
        """Nats, with the price of each effect."""
        return self.of(names).evidence - len(names) * np.log(N_EQUALLY_LIKELY_CANDIDATES)

    def cost(self, names: Effects, scatter: float) -> float:
        """Nats by which corners and numbers are off where a corner's error is that: without the price of numbers that are free."""
        return fit_scene(self._scene, self.prior(names), self.start, scatter, self.of(names)).cost

    def estimates(self, effect: str, without: Effects = frozenset()) -> dict[str, ValueWithInterval]:
        """The numbers of an effect over all fits that have it as a gap, and none `without`, as probable as each of them is."""
        having = [n for n in self._made if effect in n and not n & without]
        values = np.array([self.value(n) for n in having])
        near = np.flatnonzero(values > values.max() - COMPARISON.distant)
        share, fits = np.exp(values[near] - values.max()), [self._made[having[n]] for n in near]
        share /= share.sum()
        found = {}
        for n in EFFECTS[effect].numbers:
            middle, width = (np.array(v) for v in zip(*((f.vector[n], np.sqrt(f.covariance[n, n])) for f in fits)))
            freedom = np.array([f.freedom for f in fits])
            found[NAMES[n]] = ValueWithInterval(float(share @ middle), *_interval(share, middle, width, freedom))
        return found

    def near(self, names: Effects) -> list[Effects]:
        """Explanations that are about as probable as this one."""
        return [
            other for other in self._made if self.value(names) - self.value(other) < INDISTINGUISHABLE_LOG_BAYES_FACTOR
        ]


def _interval(share: np.ndarray, middle: np.ndarray, width: np.ndarray, freedom: np.ndarray) -> tuple[float, float]:
    """95 % interval of a mixture of Student's distributions, each argument (m,)."""
    widest = student.ppf(0.99999, freedom.min()) * width.max()
    low, high = middle.min() - widest, middle.max() + widest

    def at(level: float) -> float:
        return brentq(lambda x: share @ student.cdf((x - middle) / width, freedom) - level, low, high, xtol=1e-9)

    return float(at(0.025)), float(at(0.975))


def _finding(models: _CameraModels, chosen: Effects, effect: str) -> TaskFinding:
    """The effect with all that may stand in its place: as probable, or as near to the corners with the same scatter."""
    rest, scatter = chosen - {effect}, models.of(chosen).scatter
    cost = models.cost(chosen, scatter)
    others = [name for name in EFFECTS if name not in chosen]
    rivals = {
        name for name in others if models.cost(rest | {name}, scatter) - cost < INDISTINGUISHABLE_LOG_BAYES_FACTOR
    }
    rivals |= {name for near in models.near(chosen) if effect not in near for name in near - chosen}
    log_bayes_factor = models.value(chosen) - models.value(rest)
    estimates = {effect: models.estimates(effect, frozenset(rivals))}
    estimates |= {name: models.estimates(name, frozenset([effect])) for name in others if name in rivals}
    return TaskFinding(tuple(_hypothesis(*one) for one in estimates.items()), log_bayes_factor, "view")


def _hypothesis(effect: str, estimates: dict[str, ValueWithInterval]) -> Hypothesis:
    known = EFFECTS[effect]
    patch = dict(zip(known.quantities, (value.value for value in estimates.values())))
    return Hypothesis(effect, tuple(known.ids), estimates, patch)


def _bounds(models: _CameraModels, chosen: Effects) -> dict:
    """`bounds` and `unseen` of a View."""
    bounds: dict[str, ValueWithInterval] = {}
    for effect in EFFECTS:
        models.of(chosen | {effect})
        bounds |= models.estimates(effect)
    unseen = tuple(name for name in NAMES if not BY_NAME[name].is_informative(bounds[name].low, bounds[name].high))
    return {"bounds": {name: bounds[name] for name in NAMES}, "unidentifiable": unseen}


def _insufficient(scene: CameraScene) -> str:
    """Why the places distinguish nothing, "" where they may."""
    if len(scene) < COMPARISON.places:
        where = "one place" if len(scene) == 1 else f"{len(scene)} places"
        return f"the object rested flat in {where}; {COMPARISON.places} are needed, better eight, all over the picture"
    middles = np.array([p[u].mean(axis=0) for p, u in zip(scene.pixels, scene.usable)])
    widest = float(np.linalg.norm(middles[:, None] - middles, axis=-1).max())
    if widest < COMPARISON.apart:
        return f"the places are at most {widest:.0f} px apart; {COMPARISON.apart:.0f} are needed, better all over the picture"
    return ""


def _strain(best: CameraFit, chosen: Effects) -> str:
    """What would have to be off by more than it ever is, or how much is left, for this to be the explanation; "" for nothing."""
    if best.scatter > COMPARISON.misfit:
        return f"corners are off by {best.scatter:.1f} px from view to view in the best explanation; {COMPARISON.misfit:g} are usual"
    free = {n for name in chosen for n in EFFECTS[name].numbers}
    for n, parameter in enumerate(PARAMETERS):
        largest = parameter.largest if n in free else COMPARISON.strain * parameter.usual
        if abs(best.vector[n]) > largest:
            off = f"{parameter.scale * best.vector[n]:.2g} {parameter.shown}".strip()
            return f"{parameter.text} would have to be off by {off}"
    return ""


def _size(place: RestPose) -> str:
    return " x ".join(f"{2e3 * h:.3g}" for h in place.domain.half_size) + " mm box"

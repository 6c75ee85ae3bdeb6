"""A second opinion: the parameters of a model refitted in the forward simulator.

The torque domain needs accelerations and a model that is linear in its parameters; the closed loop needs neither.
Here the same effects are fitted to the motion itself, by Gauss-Newton on the departures of short simulations
(`forward`), with the delay of the loop as a nuisance of every fit. Sensitivities are finite differences, all of them
and all windows side by side. Intervals are those of a robust (sandwich) covariance with windows as units, so that
what neighbouring samples share is not counted twice. Half of the windows are fitted to; the others judge the fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.effect import ARM
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.inference.estimates import Estimate, cut_at_zero, estimate
from sim2real.inference.search import ScoredModel
from sim2real.simulation.multiple_shooting import ShootingWindows, cut_windows, rms, simulate_departures
from sim2real.thresholds import THRESHOLDS

REFIT = THRESHOLDS.refit
ROUNDS = 3  # of Gauss-Newton, from the values of the torque domain
WINDOWS = 48  # fitted at most, and as many held out
SMALLEST_STEP = 1e-3  # of a finite difference, relative to the value
LARGEST_SHIFT = 10.0  # half widths of its interval by which a parameter may move in a round


@dataclass(frozen=True, eq=False)
class RefittedEffect:
    """An effect to refit at its place."""

    effect: str
    """Its id."""
    component: str
    """A joint's name, or "arm"."""
    parameters: Mapping[str, Estimate]
    """Estimates of the torque domain."""
    constants: Mapping[str, float]
    """Numbers that stay."""

    @property
    def is_carried(self) -> bool:
        """Whether the simulator has this effect at all, and motion shows it."""
        return ARM_EFFECTS[self.effect].is_refitted


@dataclass(frozen=True, eq=False)
class Refit:
    """Effects with estimates by simulation; RMS departures (7,) rad over held-out windows."""

    parts: tuple[RefittedEffect, ...]
    """The effects."""
    values: tuple[Mapping[str, Estimate], ...]
    """Estimates by name, one mapping an effect."""
    nominal: np.ndarray
    """RMS of the nominal arm."""
    torque_domain: np.ndarray
    """RMS with the torque domain's estimates."""
    forward: np.ndarray
    """RMS with the estimates by simulation."""
    fitted: int
    """Number of windows that were fitted."""
    held_out: int
    """Number of windows that were held out."""


def effects_to_refit(diagnosis: Diagnosis, model: ScoredModel | None = None) -> tuple[RefittedEffect, ...]:
    """The effects of the chosen model, or of another one. Joints that stay unexplained are left out."""
    joints = diagnosis.context.arm.joints
    unexplained = {joints[j] for j in diagnosis.unexplained}
    if model is None:
        return tuple(
            RefittedEffect(f.effect.id, f.component, f.parameters, f.effect.constants)
            for f in diagnosis.findings
            if f.is_chosen and f.component not in unexplained
        )
    found = []
    for m in model.members:
        place = diagnosis.design.candidates[m].component(joints)
        if place not in unexplained:
            effect, values = estimate(diagnosis.search, model, m, 0, refined=False)
            found.append(RefittedEffect(effect.id, place, values, effect.constants))
    return tuple(found)


def refit(
    recorded: ShootingWindows, parts: Sequence[RefittedEffect], delay: float = THRESHOLDS.nuisances.delay
) -> Refit | None:
    """The parts refitted together; None where the simulator carries none of them.

    delay: s that the loop has, about. Raises FloatingPointError where the simulation diverges at the start.
    """
    # The many values of a curve are no better known by short shots: it is simulated as it was found.
    curves = tuple(_as_found(part) for part in parts if _is_curve(part))
    parts = tuple(part for part in parts if part.is_carried and part.parameters)
    if not parts:
        return None
    fitted, judged_on = recorded[0::2], recorded[1::2]
    if len(fitted) > WINDOWS:
        fitted = fitted[np.linspace(0, len(fitted) - 1, WINDOWS).astype(int)]
    if len(judged_on) > WINDOWS:
        judged_on = judged_on[np.linspace(0, len(judged_on) - 1, WINDOWS).astype(int)]
    names = [(n, name) for n, part in enumerate(parts) for name in part.parameters]
    x = np.array([parts[n].parameters[name].value for n, name in names])
    half = np.array([parts[n].parameters[name].half_width for n, name in names])
    scale = np.maximum(half, SMALLEST_STEP * np.abs(x))
    has_delay = any(part.effect == "command_delay" for part in parts)
    if not has_delay:
        x, scale = np.append(x, delay), np.append(scale, THRESHOLDS.nuisances.delay_spread)
    start = x.copy()

    def patch(values: np.ndarray) -> Patch:
        return Patch((*_make_patch(parts, names, values).effects, *curves))

    prior = np.zeros(len(x))
    if not has_delay:
        prior[-1] = 1.0  # in units of its scale
    for _ in range(ROUNDS):
        trials = [x, *(x + row for row in np.diag(scale))]
        errors = simulate_departures(fitted, [patch(values) for values in trials])
        spread = np.maximum(rms(errors[0]), REFIT.finest)
        residual = errors[0] / spread
        slope = np.moveaxis(errors[1:] - errors[0], 0, -1) / spread[:, None]  # (W, samples, 7, p)
        normal = np.einsum("wsjp,wsjq->pq", slope, slope) + np.diag(prior)
        pull = np.einsum("wsjp,wsj->wp", slope, residual)
        shift = np.linalg.solve(
            normal + 1e-9 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(x)),
            -pull.sum(axis=0) - prior * (x - start) / scale,
        )
        x = x + scale * np.clip(shift, -LARGEST_SHIFT, LARGEST_SHIFT)
    inverse = np.linalg.inv(normal + 1e-12 * np.eye(len(x)))
    few = len(fitted) / max(len(fitted) - len(x), 1)
    covariance = inverse @ (few * pull.T @ pull + np.diag(prior)) @ inverse
    error = THRESHOLDS.estimates.t95 * scale * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    judged = simulate_departures(judged_on, [Patch(), patch(start), patch(x)])
    values: list[dict[str, Estimate]] = [{} for _ in parts]
    for (n, name), value, width in zip(names, x, error):
        unit = parts[n].parameters[name].unit
        values[n][name] = Estimate(float(value), float(value - width), float(value + width), unit)
    estimates = tuple(cut_at_zero(part.effect, own) for part, own in zip(parts, values))
    return Refit(parts, estimates, *rms(judged), len(fitted), len(judged_on))


def _is_curve(part: RefittedEffect) -> bool:
    return bool(ARM_EFFECTS[part.effect].special_cases)


def _as_found(part: RefittedEffect) -> PatchEffect:
    values = {name: e.value for name, e in part.parameters.items()}
    return PatchEffect(part.effect, part.component, {**values, **part.constants})


def _make_patch(parts: Sequence[RefittedEffect], names: Sequence[tuple[int, str]], values: np.ndarray) -> Patch:
    by_part: list[dict[str, float]] = [dict(part.constants) for part in parts]
    for (n, name), value in zip(names, values):
        by_part[n][name] = float(value)
    effects = [PatchEffect(part.effect, part.component, own) for part, own in zip(parts, by_part)]
    if len(values) > len(names):
        effects.append(PatchEffect("command_delay", ARM, {"delay": float(values[-1])}))
    return Patch(tuple(effects))


def refit_in_simulation(diagnosis: Diagnosis, rivals: Sequence[ScoredModel] = ()) -> dict | None:
    """The chosen model and its rivals refitted, as in the report.

    None for another arm, for recordings without commands, or where nothing is to be refitted.
    """
    if diagnosis.context.arm.joints != NOMINAL.joints:
        return None
    recorded = cut_windows(diagnosis.context.logs)
    if recorded is None or len(recorded) < REFIT.windows_least:
        return None
    delay = next(
        (p.centre for p in diagnosis.design.parameters if p.name == "command_delay"), THRESHOLDS.nuisances.delay
    )
    found = []
    for model in (None, *rivals):
        parts = effects_to_refit(diagnosis, model)
        try:
            done = refit(recorded, parts, delay)
        except (
            FloatingPointError,
            np.linalg.LinAlgError,
            ValueError,
        ) as error:  # no such arm, or none that stands
            found.append({"effects": _titles(parts), "error": str(error)})
            continue
        if done is not None:
            found.append(_refit_row(done, [p for p in parts if not p.is_carried and not _is_curve(p)]))
    return {"structures": found} if found else None


def is_disagreement(one: Estimate, other: Estimate) -> bool:
    """Whether two estimates differ by more than both intervals together, and than two simulators do."""
    difference = abs(one.value - other.value)
    halves = np.hypot(one.half_width, other.half_width)
    return bool(difference > halves and difference > REFIT.agree * max(abs(one.value), abs(other.value)))


def _titles(parts: Sequence[RefittedEffect]) -> list[str]:
    return [f"{part.effect} at {part.component}" for part in parts]


def _refit_row(done: Refit, left_out: Sequence[RefittedEffect]) -> dict:
    rows = []
    for part, values in zip(done.parts, done.values):
        for name, forward in values.items():
            torque = part.parameters[name]
            rows.append(
                {
                    "effect": part.effect,
                    "component": part.component,
                    "parameter": name,
                    "unit": forward.unit,
                    "torque_domain": torque.row(),
                    "forward": forward.row(),
                    "disagree": is_disagreement(torque, forward),
                }
            )
    overall = [
        float(np.sqrt(np.mean(np.square(values)))) for values in (done.nominal, done.torque_domain, done.forward)
    ]
    return {
        "effects": _titles(done.parts),
        "not_carried": _titles(left_out),
        "parameters": rows,
        "closed_loop_rad": dict(zip(("nominal", "torque_domain", "forward"), overall)),
        "windows_fitted": done.fitted,
        "windows_held_out": done.held_out,
    }

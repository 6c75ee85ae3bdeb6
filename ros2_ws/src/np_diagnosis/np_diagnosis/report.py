"""The answer as files: report.json after data/gap_report.schema.json, and report.html with everything."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import jinja2
import numpy as np

from np_diagnosis import plots
from np_diagnosis.diagnosis import Diagnosis, Finding
from np_diagnosis.effects import catalogue, equivalence_classes
from np_diagnosis.ladder import REGIMES, regimes, rungs
from np_diagnosis.schema import validate
from np_diagnosis.signals import Log


def make_report(diagnosis: Diagnosis, logs: Sequence[Log], runtime: float) -> dict:
    """The report as a JSON object. Raises ValueError if it breaks the schema."""
    report = {
        "schema_version": 1,
        "verdict": diagnosis.verdict,
        "where": where(diagnosis),
        "effects": [_effect(f) for f in _ranked(diagnosis)],
        "gap": {
            "metric": "held-out RMSE of joint torque, averaged over the joints that moved",
            "unit": "Nm",
            "before": diagnosis.before,
            "after": diagnosis.after,
            "floor": diagnosis.floor,
            "shrink": diagnosis.shrink,
            "shrink_ci95": [float(v) for v in diagnosis.shrink_interval],
            "by_component": {
                r.joint: {
                    "verdict": r.verdict,
                    "before": r.before,
                    "with_arm_effect": r.with_arm,
                    "after": r.after,
                    "floor": r.floor,
                    "floor_is_measured": r.is_floor_measured,
                    "stamp_delay_s": r.delay,
                    "regimes": _regimes(diagnosis, j),
                }
                for j, r in enumerate(diagnosis.joints)
            },
        },
        "next_experiment": next_experiment(diagnosis),
        "data": {
            "bags": [log.name for log in logs],
            "duration_s": sum(log.duration for log in logs),
            "train_trajectories": diagnosis.blocks - 1,
            "test_trajectories": diagnosis.blocks,
            "held_out": "each block of contiguous motion once, by a fit to the others at least 0.5 s away",
            "ladder": {
                log.name: {rung.name: [float(v) for v in rung.rms] for rung in rungs(log)} for log in logs
            },
        },
        "runtime_s": runtime,
    }
    validate(report, json.loads((files("np_diagnosis") / "data" / "gap_report.schema.json").read_text()))
    return report


def where(diagnosis: Diagnosis) -> list[dict]:
    """Shares of the gap's energy above the floor by module and component; the rest is unknown."""
    energy: dict[tuple[str, str], float] = {}

    def add(module: str, component: str, amount: float) -> None:
        if amount > 0:
            energy[module, component] = energy.get((module, component), 0.0) + amount

    arm = next((f for f in diagnosis.arm if f.is_chosen), None)
    for r in diagnosis.joints:
        if r.verdict in ("no_gap", "not_excited"):
            continue
        if arm is not None:
            add(arm.effect.entry["module"], arm.component, r.before**2 - r.with_arm**2)
        chosen = [f for f in r.findings if f.is_chosen]
        weights = np.array([max(f.shrink, 1e-3) for f in chosen])
        for finding, weight in zip(chosen, weights / weights.sum() if chosen else ()):
            add(finding.effect.entry["module"], r.joint, weight * (r.with_arm**2 - r.after**2))
        add("unknown", r.joint, r.after**2 - r.floor**2)
    total = sum(energy.values())
    ranked = sorted(energy.items(), key=lambda item: -item[1])
    return [{"module": m, "component": c, "share": float(e / total)} for (m, c), e in ranked]


def next_experiment(diagnosis: Diagnosis) -> dict | None:
    """What would split the first ambiguity of the report, None where there is none."""
    for finding in _ranked(diagnosis):
        if not finding.is_chosen or not finding.equivalent_to:
            continue
        ids = {finding.effect.id, *finding.equivalent_to}
        split = next((text for members, text in equivalence_classes() if len(members & ids) > 1), None)
        if split is None and ids >= {"asymmetric_coulomb_friction", "torque_offset"}:
            split = next(
                text for members, text in equivalence_classes() if "asymmetric_coulomb_friction" in members
            )
        return {
            "name": split or catalogue()[finding.effect.id]["exciting_experiment"],
            "separates": sorted(ids),
            "component": finding.component,
        }
    return None


def write(out: Path, diagnosis: Diagnosis, logs: Sequence[Log], runtime: float) -> dict:
    """Write report.json and report.html into the folder `out`; returns the report."""
    report = make_report(diagnosis, logs, runtime)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("np_diagnosis", "data"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    ladder = [(log.name, rungs(log)) for log in logs]
    text = environment.get_template("report.html.j2").render(
        report=report,
        diagnosis=diagnosis,
        findings=_ranked(diagnosis),
        regimes=REGIMES,
        ladder=ladder,
        gap_plot=plots.gap_plot(diagnosis),
        residual_plot=plots.residual_plot(diagnosis),
        velocity_plot=plots.velocity_plot(diagnosis),
    )
    (out / "report.html").write_text(text, encoding="utf-8")
    return report


def _ranked(diagnosis: Diagnosis) -> list[Finding]:
    findings = [*diagnosis.arm, *(f for r in diagnosis.joints for f in r.findings)]
    return sorted(findings, key=lambda f: (not f.is_chosen, -f.probability))


def _effect(finding: Finding) -> dict:
    return {
        "effect": finding.effect.id,
        "component": finding.component,
        "probability": min(1.0, finding.probability),
        "equivalent_to": list(finding.equivalent_to),
        "parameters": {
            name: {"value": e.value, "ci95": [e.low, e.high], "unit": e.unit}
            for name, e in finding.parameters.items()
        },
        "gap_shrink": finding.shrink,
        "shape": finding.effect.shape,
        "is_added": finding.is_chosen,
    }


def _regimes(diagnosis: Diagnosis, joint: int) -> dict[str, dict[str, float] | None]:
    """RMSE Nm before and after in each regime; None where the joint was not in it while moving."""
    result = diagnosis.joints[joint]
    table = {}
    for name, mask in regimes(diagnosis.samples).items():
        rows = mask[:, joint] & np.isfinite(result.residual_after)
        table[name] = (
            {
                side: float(np.sqrt((values[rows] ** 2).mean()))
                for side, values in (("before", result.residual_before), ("after", result.residual_after))
            }
            if rows.any()
            else None
        )
    return table

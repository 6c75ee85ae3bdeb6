"""The result as files: report.json after data/gap_report.schema.json, report.html, and patch.yaml."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from sim2real.consequences import Consequences
from sim2real.diagnosis import Diagnosis
from sim2real.effects.patch import Patch, dump_patch
from sim2real.finding import Finding
from sim2real.gap_location import list_growing_gaps, locate_gap, regime_gaps, stage_gaps
from sim2real.inference.estimates import Estimate
from sim2real.progress import StageCallback, ignore_stage
from sim2real.recordings.signals import Log
from sim2real.report.control_loop import describe_broken_loops, describe_loops
from sim2real.report.held_out import describe_held_out
from sim2real.report.notes import list_notes
from sim2real.simulation.patch_trial import PatchTrial


def make_report(
    diagnosis: Diagnosis, logs: Sequence[Log], runtime: float, consequences: Consequences | None = None
) -> dict:
    """The report as a JSON object; runtime: s."""
    done = consequences or Consequences(Patch())
    gap, joints = diagnosis.gap, diagnosis.context.arm.joints
    return {
        "schema_version": 1,
        "verdict": diagnosis.verdict,
        "sentence": " ".join([diagnosis.sentence, *describe_broken_loops(logs)]),
        "where": locate_gap(diagnosis),
        "effects": [_effect_row(f) for f in diagnosis.findings] if diagnosis.verdict != "no_gap" else [],
        "gap": {
            "metric": "RMS of the torque residuals of all rungs, averaged over the joints that moved, each block predicted by a fit to the others; effects were chosen on all of these blocks",
            "unit": "Nm",
            "before": gap.before,
            "after": gap.after,
            "floor": gap.floor,
            "shrink": gap.shrink,
            "shrink_ci95": list(gap.shrink_interval),
            "by_component": {
                joint: {
                    "before": float(gap.before_joint[j]),
                    "after": float(gap.after_joint[j]),
                    "floor": float(gap.floor_joint[j]),
                    "floor_is_measured": bool(gap.is_floor_measured[j]),
                    "moved": bool(gap.moved[j]),
                    "unexplained": j in diagnosis.unexplained,
                    "ladder": stage_gaps(diagnosis, j),
                    "regimes": regime_gaps(diagnosis, j),
                }
                for j, joint in enumerate(joints)
            },
            "worse": list_growing_gaps(diagnosis),
            "not_patched": list(done.trial.left_out) if done.trial else [],
            "closed_loop_rad": _closed_loop(done.trial, joints),
        },
        "held_out": describe_held_out(diagnosis, done),
        "next_experiment": done.experiment,
        "forward": done.refit,
        "arm": [
            {
                "quantity": one.quantity,
                "component": one.component,
                "nominal": one.nominal,
                **_estimate_row(one.estimate),
            }
            for one in done.arm
        ],
        "control_loop": describe_loops(logs, diagnosis.findings),
        "data": {
            "bags": [log.name for log in logs],
            "reference": [log.name for log in diagnosis.context.logs[: diagnosis.context.reference]],
            "duration_s": sum(log.duration for log in logs),
            "train_trajectories": len(diagnosis.design.blocks) - 1,
            "test_trajectories": len(diagnosis.design.blocks),
            "held_out": "each block of contiguous motion once, by a fit to the others at least 0.5 s away",
        },
        "notes": list_notes(diagnosis, done.trial is not None),
        "runtime_s": runtime,
    }


def _closed_loop(trial: PatchTrial | None, joints: Sequence[str]) -> dict[str, dict[str, float]]:
    """Departures rad by joint, none without a simulation."""
    if trial is None:
        return {}
    if not np.isfinite([trial.before, trial.after]).all():
        return {"diverged": {"before": 0.0, "after": 0.0}}
    return {j: {"before": float(b), "after": float(a)} for j, b, a in zip(joints, trial.before, trial.after)}


def to_json(report: dict, quick: bool = False) -> str:
    """A report as text; quick: not held against its schema, data/gap_report.schema.json.

    Raises ValueError naming where a report breaks its schema, or for a number that is not finite.
    """
    if not quick:  # the import alone takes a tenth of a second
        from jsonschema import Draft202012Validator
        from jsonschema.exceptions import best_match

        schema = json.loads((files("sim2real") / "data" / "gap_report.schema.json").read_text(encoding="utf-8"))
        error = best_match(Draft202012Validator(schema).iter_errors(report))
        if error is not None:
            raise ValueError(f"report: {error.json_path}: {error.message}")
    return json.dumps(report, indent=1, allow_nan=False) + "\n"


def write_report(
    out: Path,
    diagnosis: Diagnosis,
    logs: Sequence[Log],
    consequences: Consequences,
    runtime: Callable[[], float] = lambda: 0.0,
    quick: bool = False,
    tell: StageCallback = ignore_stage,
) -> dict:
    """Write report.json, patch.yaml and report.html into `out`; returns the report.

    runtime: s it has taken so far; quick: without the page and the check against the schema; tell: called with the stage of
    `progress` that begins. Raises ValueError as `to_json` does.
    """
    report = make_report(diagnosis, logs, round(runtime(), 2), consequences)
    text = to_json(report, quick)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").write_text(text, encoding="utf-8")
    (out / "patch.yaml").write_text(dump_patch(consequences.patch, diagnosis.context.arm.name), encoding="utf-8")
    if not quick:
        tell("page")
        from sim2real.report.page import render  # drawing is slow to import

        (out / "report.html").write_text(render(report, diagnosis, out), encoding="utf-8")
    return report


def _estimate_row(one: Estimate) -> dict:
    return {**one.row(), "unit": one.unit}


def _effect_row(finding: Finding) -> dict:
    return {
        "effect": finding.effect.id,
        "component": finding.component,
        "probability": min(1.0, finding.probability),
        "class_probability": finding.class_probability,
        "special_case_of": list(finding.generalised_by),
        "equivalent_to": list(finding.equivalent_to),
        "parameters": {name: _estimate_row(e) for name, e in finding.parameters.items()},
        "gap_shrink": finding.shrink,
        "variant": finding.effect.variant,
        "is_added": finding.is_chosen,
    }

"""The task diagnosis as JSON, after data/task_report.schema.json."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.resources import files

from sim2real.effects.sentences import ValueWithInterval
from sim2real.report import camera_sentences, contact_sentences, noise_sentences
from sim2real.report.control_loop import describe_broken_loops, describe_loops
from sim2real.report.task_sentences import hypothesis_text, module_text, next_steps, sentence
from sim2real.task.diagnosis import ModuleResult, TaskDiagnosis, make_patch
from sim2real.task.hypotheses import TaskFinding, module_of
from sim2real.task.object_motion.patch_check import CheckedPatch
from sim2real.task.object_motion.prediction import MotionPrediction

UNITS = {"table": "friction_table", "finger": "friction_fingertip", "mass": "mass_kg"}


def document(
    diagnosis: TaskDiagnosis,
    bags: list[str],
    checked: CheckedPatch | None = None,
    predicted: MotionPrediction | None = None,
) -> dict:
    """The report in SI units, px in images, with 95 % intervals.

    checked: what of the patch is given (default: all of it); predicted: the object's motion without the patch and with it.
    """
    checked = checked or CheckedPatch(make_patch(diagnosis), {})
    return {
        "schema_version": 1,
        "verdict": diagnosis.verdict,
        "sentence": " ".join(
            [
                sentence(diagnosis),
                *_withheld(checked),
                *_added(checked),
                *describe_broken_loops(diagnosis.recordings.logs),
            ]
        ),
        "rows": [_module(one, diagnosis, predicted) for one in diagnosis.modules],
        "effects": [
            {"effect": e.effect, "component": e.component, "parameters": dict(e.parameters)}
            for e in checked.patch.effects
        ],
        "withheld": [{"effect": effect, "removed": _value(removed)} for effect, removed in checked.withheld.items()],
        "added": [{"effect": effect, "removed": _value(removed)} for effect, removed in checked.added.items()],
        "motion": None if predicted is None else {**asdict(predicted), "removed": _value(predicted.removed)},
        "next": next_steps(diagnosis),
        "measured": _measured(diagnosis),
        "control_loop": describe_loops(diagnosis.recordings.logs),
        "stages": _stages(diagnosis),
        "data": {
            "bags": bags,
            "suites": len(diagnosis.recordings.tasks),
            "places": len(diagnosis.recordings.rest_poses),
        },
    }


def check_schema(report: dict) -> None:
    """Raises jsonschema.ValidationError for a report that does not follow its schema."""
    import jsonschema  # slow

    task, arm = (
        json.loads((files("sim2real") / "data" / f"{name}_report.schema.json").read_text(encoding="utf-8"))
        for name in ("task", "gap")
    )
    task["properties"]["control_loop"] = arm["properties"]["control_loop"]  # the file only refers to it
    jsonschema.validate(report, task)


def _withheld(checked: CheckedPatch) -> list[str]:
    if not checked.withheld:
        return []
    names = ", ".join(checked.withheld)
    return [f"Not in the patch, for the simulated object moves worse with it in this very recording: {names}."]


def _added(checked: CheckedPatch) -> list[str]:
    return [
        f"In the patch, though it is not named by itself: {effect}. It removes {removed:%} of the simulated object's error in this recording."
        for effect, removed in checked.added.items()
    ]


def _module(result: ModuleResult, diagnosis: TaskDiagnosis, predicted: MotionPrediction | None) -> dict:
    by_effect = predicted.by_effect if predicted else {}
    removed = [share for effect, share in by_effect.items() if module_of(effect) == result.module]
    return {
        "module": result.module,
        "verdict": result.verdict,
        "share": result.share,
        "motion": sum(removed) if removed else None,
        "said": module_text(result, diagnosis),
        "claims": [_finding(one) for one in result.findings],
    }


def _finding(finding: TaskFinding) -> dict:
    hypotheses = [
        {
            "name": one.name,
            "effects": list(one.effects),
            "said": hypothesis_text(finding, one),
            "sizes": {name: _value(value) for name, value in one.estimates.items()},
        }
        for one in finding.hypotheses
    ]
    return {"stage": finding.source, "gain_nats": float(finding.log_bayes_factor), "ways": hypotheses}


def _value(value: ValueWithInterval) -> dict:
    return {"value": float(value.value), "ci95": [float(value.low), float(value.high)]}


def _measured(diagnosis: TaskDiagnosis) -> dict:
    """Absolute numbers: coefficients of friction, mass kg, height m of the table, latency s."""
    forces, found = diagnosis.forces, {}
    if forces and forces.measured:
        found |= {UNITS[name]: _value(ValueWithInterval(*values)) for name, values in forces.measured.items()}
    if forces and forces.least_finger is not None:
        found["friction_fingertip_at_least"] = float(forces.least_finger)
    if diagnosis.surfaces and diagnosis.surfaces.comparison:
        found["table_height_m"] = _value(diagnosis.surfaces.comparison.bounds["height"])
    if diagnosis.latency and diagnosis.latency.late:
        found["late_s"] = _value(diagnosis.latency.late)
    return found


def _stages(diagnosis: TaskDiagnosis) -> dict:
    """Verdict and abstention reason of each stage; the camera's and the hand's results in full."""
    brief = (("meeting", diagnosis.hand_eye), ("untouched", diagnosis.static_scene), ("lag", diagnosis.latency))
    reasons = diagnosis.abstention_reasons
    stages = {name: {"verdict": one.verdict, "doubt": reasons.get(name, "")} for name, one in brief if one is not None}
    if diagnosis.camera is not None:
        stages["view"] = camera_sentences.document(diagnosis.camera)
    if diagnosis.noise is not None:
        stages["scatter"] = noise_sentences.document(diagnosis.noise)
    if diagnosis.surfaces is not None and diagnosis.forces is not None:
        stages |= contact_sentences.document(diagnosis.surfaces, diagnosis.forces)
    if diagnosis.arm is not None:
        stages["arm"] = {"verdict": diagnosis.arm.verdict, "doubt": ""}
    for name, reason in reasons.items():
        stages.setdefault(name, {"verdict": "undetermined", "doubt": reason})
    return stages

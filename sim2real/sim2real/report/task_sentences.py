"""What all stages of the chain found together, in words, as JSON and as a patch."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.resources import files

from sim2real.effects.sentences import ValueWithInterval
from sim2real.report import camera_sentences as view_words
from sim2real.report import contact_sentences as felt_words
from sim2real.task import noise_effects as findings
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.diagnosis import NOT_SEEN, ModuleResult, TaskDiagnosis, make_patch
from sim2real.task.findings import Finding, Hypothesis, module_of
from sim2real.task.object_motion.patch_check import CheckedPatch
from sim2real.task.object_motion.prediction import MotionPrediction

SPLIT_BY = {
    "view": view_words.PUT_DOWN,
    "force": "drags of the object from above, by several forces (excite --suite task)",
    "meeting": f"{view_words.PUT_DOWN}, and measured there by something else than the camera",
    "lag": "a second clock: stamps of the camera's own, or a light that both see",
}
"""By stage: what tells the members of its classes apart."""


def sentence(whole: TaskDiagnosis) -> str:
    """The finding: what accounts for most of what is off, in words."""
    unexplained = [row for row in whole.rows if row.verdict == "unexplained"]
    off = sorted((row for row in whole.rows if row.share), key=lambda row: -row.share)
    said = []
    if unexplained:
        where = " and ".join(row.module for row in unexplained)
        said.append(f"Something at the {where} is off that the doctor has no word for: {unexplained[0].doubt}.")
    if off:
        top = off[0]
        begin = (
            "What is off"
            if top.share > 0.995
            else f"Most of what is off ({100 * top.share:.0f} %)"
            if top.share > 0.5
            else "The largest part"
        )
        said.append(f"{begin} is at the {top.module}: {finding_text(max(top.claims, key=lambda claim: claim.gain))}.")
    if arm := whole.row("arm").said:
        said.append(arm)
    quiet = [row.module for row in whole.rows if row.verdict == "no_gap"]
    if not said:
        said.append(
            f"No gap is seen: {', '.join(quiet)} are as they are believed to be." if quiet else "Nothing could be told."
        )
    if blind := [row.module for row in whole.rows if row.verdict == NOT_SEEN]:
        said.append(f"Not seen in this recording: {', '.join(blind)}.")
    return " ".join(said)


def finding_text(claim: Finding) -> str:
    """A claim in words, as half a sentence."""
    return " or ".join(way.said for way in claim.ways)


def module_text(row: ModuleResult, whole: TaskDiagnosis) -> str:
    """A row's finding in words, and what was measured."""
    if row.said and not row.claims and not row.doubt and not measured_text(row.module, whole):
        return row.said
    parts = [finding_text(claim) for claim in row.claims]
    if row.doubt:
        parts.append(row.doubt)
    text = "; ".join(parts) or "as it is believed to be"
    said = [f"{part[0].upper()}{part[1:]}." for part in (text, measured_text(row.module, whole)) if part]
    return " ".join([*said, row.said] if row.said else said)


def measured_text(module: str, whole: TaskDiagnosis) -> str:
    """What was measured of a module, beside what is believed; "" where nothing was."""
    said = []
    if module == "contact" and whole.force and whole.force.measured:
        believed, found = NominalContact.of(whole.seen.tasks[0].domain), whole.force.measured
        if "table" in found:
            said.append(f"friction with the table {ValueWithInterval(*found['table']):1}, believed {believed.table:g}")
        if "finger" in found:
            said.append(f"with the fingertip {ValueWithInterval(*found['finger']):1}, believed {believed.finger:g}")
        elif whole.force.least_finger is not None:
            said.append(f"with the fingertip {whole.force.least_finger:.2f} at least, believed {believed.finger:g}")
    elif module == "object" and whole.force and "mass" in (whole.force.measured or {}):
        mass = ValueWithInterval(*(1e3 * value for value in whole.force.measured["mass"]))
        said.append(f"mass {mass:g}, believed {1e3 * whole.seen.tasks[0].domain.mass:.0f} g")
    elif module == "table" and whole.touch and whole.touch.explained:
        said.append(f"height {whole.touch.explained.bounds['height']:mm}")
    elif module == "timing" and whole.lag and whole.lag.late:
        said.append(f"images are {whole.lag.late:ms late/early}")
    elif module == "keypoints" and whole.scatter:
        said.append(f"scatter {whole.scatter.spread:px}, gross errors {whole.scatter.share:%}")
    elif (
        module == "camera"
        and not whole.row("camera").claims
        and whole.meeting
        and whole.meeting.explained
        and whole.meeting.verdict != "undetermined"
    ):
        off = whole.meeting.explained.bounds
        said.append(f"the hand meets things {off['x']:mm} and {off['y']:mm} (x, y) from where they are seen")
    return "; ".join(said).replace(" 1 (", " (")


def document(
    whole: TaskDiagnosis, bags: list[str], kept: CheckedPatch | None = None, predicted: MotionPrediction | None = None
) -> dict:
    """The answer as chain.json has it, after data/task_report.schema.json: SI units, px in images, intervals of 95 %. kept: what of the
    patch is given (all of it); predicted: the object's motion, without the patch and with it."""
    kept = kept or CheckedPatch(make_patch(whole), {})
    return {
        "schema_version": 1,
        "verdict": whole.verdict,
        "sentence": " ".join([sentence(whole), *_left_out(kept)]),
        "rows": [_row(row, whole, predicted) for row in whole.rows],
        "effects": [
            {"effect": e.effect, "component": e.component, "parameters": dict(e.parameters)} for e in kept.patch.effects
        ],
        "withheld": [{"effect": effect, "removed": _value(removed)} for effect, removed in kept.withheld.items()],
        "motion": None if predicted is None else {**asdict(predicted), "removed": _value(predicted.removed)},
        "next": next_steps(whole),
        "measured": _measured(whole),
        "stages": _stages(whole),
        "data": {"bags": bags, "suites": len(whole.seen.tasks), "places": len(whole.seen.places)},
    }


def _left_out(kept: CheckedPatch) -> list[str]:
    """In words, what makes the object's motion worse."""
    if not kept.withheld:
        return []
    names = ", ".join(kept.withheld)
    return [f"Not in the patch, for the simulated object moves worse with it in this very recording: {names}."]


def next_steps(whole: TaskDiagnosis) -> list[str]:
    """Experiments that tell apart what is a class, and that show what was not seen."""
    claims = [claim for row in whole.rows for claim in row.claims if not claim.is_one]
    steps = [SPLIT_BY[claim.stage] for claim in claims if claim.stage in SPLIT_BY]
    if any(row.verdict == NOT_SEEN and row.module not in ("arm", "camera") for row in whole.rows):
        steps.append("the task suite (excite --suite task)")
    if whole.row("camera").verdict == NOT_SEEN:
        steps.append(view_words.PUT_DOWN)
    return list(dict.fromkeys(steps))


def check_schema(told: dict) -> None:
    """Raises jsonschema.ValidationError for an answer that is not as its schema has it."""
    import jsonschema  # slow

    schema = json.loads((files("sim2real") / "data" / "task_report.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(told, schema)


def _row(row: ModuleResult, whole: TaskDiagnosis, predicted: MotionPrediction | None) -> dict:
    mine = (
        {effect: gone for effect, gone in predicted.by_effect.items() if module_of(effect) == row.module}
        if predicted
        else {}
    )
    return {
        "module": row.module,
        "verdict": row.verdict,
        "share": row.share,
        "motion": sum(mine.values()) if mine else None,
        "said": module_text(row, whole),
        "claims": [
            {"stage": c.stage, "gain_nats": float(c.gain), "ways": [_way(way) for way in c.ways]} for c in row.claims
        ],
    }


def _way(way: Hypothesis) -> dict:
    return {
        "name": way.name,
        "effects": list(way.ids),
        "said": way.said,
        "sizes": {n: _value(v) for n, v in way.sizes.items()},
    }


def _value(value: ValueWithInterval) -> dict:
    return {"value": float(value.value), "ci95": [float(value.low), float(value.high)]}


def _measured(whole: TaskDiagnosis) -> dict:
    """Numbers that are no change: coefficients, mass kg, table's height m, s by which images are late."""
    found = {}
    if whole.force and whole.force.measured:
        units = {"table": "friction_table", "finger": "friction_fingertip", "mass": "mass_kg"}
        found |= {units[name]: _value(ValueWithInterval(*values)) for name, values in whole.force.measured.items()}
    if whole.force and whole.force.least_finger is not None:
        found["friction_fingertip_at_least"] = float(whole.force.least_finger)
    if whole.touch and whole.touch.explained:
        found["table_height_m"] = _value(whole.touch.explained.bounds["height"])
    if whole.lag and whole.lag.late:
        found["late_s"] = _value(whole.lag.late)
    return found


def _stages(whole: TaskDiagnosis) -> dict:
    """Each stage's verdict and doubt; the view's and the hand's own answers."""
    stages = {
        name: {"verdict": stage.verdict, "doubt": whole.doubts.get(name, "")}
        for name, stage in (("meeting", whole.meeting), ("untouched", whole.still), ("lag", whole.lag))
        if stage is not None
    }
    if whole.view is not None:
        stages["view"] = view_words.document(whole.view)
    if whole.scatter is not None:
        stages["scatter"] = findings.document(whole.scatter)
    if whole.touch is not None and whole.force is not None:
        stages |= {name: felt_words.document(whole.touch, whole.force)[name] for name in ("touch", "force")}
    if whole.arm is not None:
        stages["arm"] = {"verdict": whole.arm.verdict, "doubt": ""}
    for name, doubt in whole.doubts.items():
        stages.setdefault(name, {"verdict": "undetermined", "doubt": doubt})
    return stages

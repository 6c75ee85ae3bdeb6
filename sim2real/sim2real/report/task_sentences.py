"""The task diagnosis in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.sentences import ValueWithInterval, describe_effect
from sim2real.report import camera_sentences, contact_sentences
from sim2real.report.camera_sentences import PUT_DOWN
from sim2real.report.sentence import NAMED
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.diagnosis import NOT_SEEN, ModuleResult, TaskDiagnosis
from sim2real.task.hypotheses import Hypothesis, TaskFinding

CLOCK = "a second clock: stamps of the camera's own, or a light that both see"
SPLIT_BY = {
    "view": PUT_DOWN,
    "force": "drags of the object from above, by several forces (excite --suite task)",
    "meeting": f"{PUT_DOWN}, and measured there by something else than the camera",
    "lag": CLOCK,
}
"""By stage: the experiment that distinguishes its hypotheses."""
OFFSET_NAMES = {"camera_place": "place", "camera_turn": "turn"}


def sentence(diagnosis: TaskDiagnosis) -> str:
    """The main finding: what accounts for most of what is off, and what else is."""
    unexplained = [one for one in diagnosis.modules if one.verdict == "unexplained"]
    off = sorted((one for one in diagnosis.modules if one.share), key=lambda one: -one.share)
    parts = []
    if unexplained:
        where = " and ".join(one.module for one in unexplained)
        reasons = "; ".join(one.abstention_reason for one in unexplained)
        parts.append(f"Something at the {where} is off that no known effect explains: {reasons}.")
    parts += _describe_off(off)
    if diagnosis.arm is not None and diagnosis.arm.sentence:
        parts.append(diagnosis.arm.sentence)
    quiet = [one.module for one in diagnosis.modules if one.verdict == "no_gap"]
    if not parts:
        parts.append(f"No gap is seen: {', '.join(quiet)} are nominal." if quiet else "Nothing could be determined.")
    if blind := [one.module for one in diagnosis.modules if one.verdict == NOT_SEEN]:
        parts.append(f"Not seen in this recording: {', '.join(blind)}.")
    return " ".join(parts)


def _describe_off(off: Sequence[ModuleResult]) -> Iterator[str]:
    """A sentence for each module with findings that are named, the largest share first; the others are counted.

    NAMED findings at most: the largest of each module, then further ones.
    """
    ranked = sorted((rank, row) for row, one in enumerate(off) for rank in range(len(one.findings)))
    named = Counter(row for _, row in ranked[:NAMED])
    for row, one in enumerate(off):
        largest = sorted(one.findings, key=lambda finding: -finding.log_bayes_factor)[: named[row]]
        if largest:
            yield f"{_portion(one, off)} is at the {one.module}: {'; '.join(map(finding_text, largest))}."
    others = [one.module for row, one in enumerate(off) if len(one.findings) > named[row]]
    if others:
        yield f"And {len(ranked) - NAMED} more at the {' and the '.join(others)}, see the report's table."


def _portion(one: ModuleResult, off: Sequence[ModuleResult]) -> str:
    """How much of what is off a module has, as the subject of a sentence."""
    if len(off) == 1:
        return "What is off"
    if one is not off[0]:
        return f"{100 * one.share:.0f} %" if one.share >= 0.005 else "Less than 1 %"
    if one.share > 0.995:
        return "Almost all that is off"
    return f"Most of what is off ({100 * one.share:.0f} %)" if one.share > 0.5 else "The largest part"


def finding_text(finding: TaskFinding) -> str:
    """A finding as half a sentence."""
    return " or ".join(hypothesis_text(finding, one) for one in finding.hypotheses)


def hypothesis_text(finding: TaskFinding, one: Hypothesis) -> str:
    """One hypothesis of a finding as half a sentence."""
    if finding.source == "view":
        return camera_sentences.effect_text(one.name, one.estimates)
    if finding.source in ("touch", "force"):
        return contact_sentences.effect_text(one.name, one.estimates)
    if finding.source == "meeting":
        return _offset_text(one, is_first=one is finding.hypotheses[0])
    if finding.source == "lag" and one.name == "clock_offset":
        return "the camera's clock is off by that"
    record = CAMERA_EFFECTS[one.name]
    return describe_effect(record, str(record.target), one.estimates, "the simulator")


def _offset_text(one: Hypothesis, is_first: bool) -> str:
    if one.name not in OFFSET_NAMES:
        return "where corners are found"
    if not is_first:
        return f"its {OFFSET_NAMES[one.name]}"
    off = f"the picture shows things {one.estimates['x']:mm} and {one.estimates['y']:mm} (x, y)"
    return f"{off} from where the hand meets them: by the camera's {OFFSET_NAMES[one.name]} (off the other way)"


def module_text(result: ModuleResult, diagnosis: TaskDiagnosis) -> str:
    """The findings of a module, and what was measured."""
    if result.module == "arm" and diagnosis.arm is not None and diagnosis.arm.sentence:
        return diagnosis.arm.sentence
    parts = [finding_text(one) for one in result.findings]
    if result.abstention_reason:
        parts.append(result.abstention_reason)
    text = "; ".join(parts) or "nominal"
    measured = describe_measured(result.module, diagnosis)
    return " ".join(f"{part[0].upper()}{part[1:]}." for part in (text, measured) if part)


def describe_measured(module: str, diagnosis: TaskDiagnosis) -> str:
    """What was measured of a module beside its nominal value; "" where nothing was."""
    forces, surfaces, hand_eye = diagnosis.forces, diagnosis.surfaces, diagnosis.hand_eye
    measured = (forces.measured or {}) if forces else {}
    parts = []
    if module == "contact" and measured:
        nominal = NominalContact.of(diagnosis.recordings.tasks[0].domain)
        if "table" in measured:
            parts.append(
                f"friction with the table {ValueWithInterval(*measured['table']):1}, nominal {nominal.table:g}"
            )
        if "finger" in measured:
            parts.append(f"with the fingertip {ValueWithInterval(*measured['finger']):1}, nominal {nominal.finger:g}")
        elif forces.least_finger is not None:
            parts.append(f"with the fingertip {forces.least_finger:.2f} at least, nominal {nominal.finger:g}")
    elif module == "object" and "mass" in measured:
        mass = ValueWithInterval(*(1e3 * value for value in measured["mass"]))
        parts.append(f"mass {mass:g}, nominal {1e3 * diagnosis.recordings.tasks[0].domain.mass:.0f} g")
    elif module == "table" and surfaces and surfaces.comparison:
        parts.append(f"height {surfaces.comparison.bounds['height']:mm}")
    elif module == "timing" and diagnosis.latency and diagnosis.latency.late:
        parts.append(f"images are {diagnosis.latency.late:ms late/early}")
    elif module == "keypoints" and diagnosis.noise:
        noise = diagnosis.noise
        parts.append(f"scatter {noise.spread:px}")
        if noise.share.value > 0:
            parts.append(f"{noise.share:%} of corners scatter more, by {noise.size:px}")
    elif module == "camera" and not diagnosis.module("camera").findings:
        if hand_eye and hand_eye.comparison and hand_eye.verdict != "undetermined":
            off = hand_eye.comparison.bounds
            parts.append(f"the hand meets things {off['x']:mm} and {off['y']:mm} (x, y) from where they are seen")
    return "; ".join(parts).replace(" 1 (", " (")


def next_steps(diagnosis: TaskDiagnosis) -> list[str]:
    """Experiments that distinguish hypotheses, or show what the recordings do not."""
    open_findings = [one for result in diagnosis.modules for one in result.findings if not one.is_one_effect]
    steps = [SPLIT_BY[one.source] for one in open_findings if one.source in SPLIT_BY]
    if any(one.verdict == NOT_SEEN and one.module not in ("arm", "camera") for one in diagnosis.modules):
        steps.append("the task suite (excite --suite task)")
    if diagnosis.module("camera").verdict == NOT_SEEN:
        steps.append(PUT_DOWN)
    return list(dict.fromkeys(steps))

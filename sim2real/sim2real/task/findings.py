"""What the stages found, in one form, and how findings of different stages constrain one another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim2real.effects import SCENE_EFFECTS
from sim2real.effects.sentences import ValueWithInterval
from sim2real.task.camera.diagnosis import CameraDiagnosis
from sim2real.task.contact_force.estimate import ContactForceResult
from sim2real.task.hypotheses import Hypothesis, TaskFinding
from sim2real.task.keypoint_noise import KeypointNoise, visible_noise_effects
from sim2real.task.suite.hand_eye_offset import HandEyeOffset, camera_shift
from sim2real.task.suite.image_latency import ImageLatency
from sim2real.task.surface.estimate import SurfaceContactResult

RELATIVE = "relative"
PATCH_PARAMETERS = {
    "table_height": "height",
    "table_friction": RELATIVE,
    "object_mass": RELATIVE,
    "gripper_friction": RELATIVE,
}
"""Name in `patch.yaml` of the one number of an effect of the scene."""


def camera_findings(camera: CameraDiagnosis | None) -> list[TaskFinding]:
    """What corners of the resting object show."""
    return list(camera.findings) if camera is not None and camera.verdict in ("identified", "ambiguous") else []


def contact_findings(result: SurfaceContactResult | ContactForceResult | None, source: str) -> list[TaskFinding]:
    """What touches (source `touch`) or contact forces (source `force`) show."""
    if result is None or result.comparison is None or result.verdict == "unexplained":
        return []
    return [
        replace(one, source=source, hypotheses=tuple(map(_with_patch, one.hypotheses)))
        for one in result.comparison.findings
    ]


def _with_patch(one: Hypothesis) -> Hypothesis:
    if one.name not in SCENE_EFFECTS:
        return one
    return replace(one, patch={name: value.value for name, value in patch_values(one.name, one.estimates).items()})


def patch_values(effect: str, estimates: Mapping[str, ValueWithInterval]) -> dict[str, ValueWithInterval]:
    """The number of an effect of the scene as `patch.yaml` has it: a logarithm as a relative change."""
    (value,) = estimates.values()
    if PATCH_PARAMETERS[effect] == RELATIVE:
        value = ValueWithInterval(*(float(np.expm1(number)) for number in (value.value, value.low, value.high)))
    return {PATCH_PARAMETERS[effect]: value}


def keypoint_noise_findings(noise: KeypointNoise | None) -> list[TaskFinding]:
    """What the scatter of keypoints at rest shows."""
    found = []
    for effect, values in (visible_noise_effects(noise) if noise is not None else {}).items():
        patch = {name: value.value for name, value in values.items()}
        one = Hypothesis(effect, (effect,), dict(values), patch)
        found.append(TaskFinding((one,), gaussian_log_bayes_factor(next(iter(values.values()))), "scatter"))
    return found


def latency_findings(latency: ImageLatency | None) -> list[TaskFinding]:
    """Late images: the camera's latency or its clock, which one recording cannot distinguish. A camera cannot be early."""
    if latency is None or latency.late is None or latency.verdict == "no_gap":
        return []
    late = latency.late
    hypotheses = (
        Hypothesis("camera_latency", ("camera_latency",), {"delay": late}, {"delay": late.value}),
        Hypothesis("clock_offset", ("clock_offset",), {"offset": late}, {"offset": late.value}),
    )
    return [TaskFinding(hypotheses if late.value > 0 else hypotheses[1:], gaussian_log_bayes_factor(late), "lag")]


def hand_eye_offset_findings(offset: HandEyeOffset | None, turn: np.ndarray | None = None) -> list[TaskFinding]:
    """A picture that is off where the hand touches the object: by the camera's place or rotation, or by where corners are found.

    turn: rotation (2,) rad of the camera where corners at rest prefer it (`camera_rotation`).
    """
    if offset is None or offset.comparison is None or offset.verdict not in ("identified", "ambiguous"):
        return []
    found = []
    for one in offset.comparison.findings:
        off = one.hypotheses[0].estimates
        place = Hypothesis("camera_place", ("camera_extrinsics",), dict(off), camera_shift(off))
        rotation = Hypothesis("camera_turn", ("camera_extrinsics",), dict(off))
        corners = Hypothesis("image_offset", ("keypoint_bias",), {})
        hypotheses = (place, rotation, corners)
        if turn is not None:
            patch = dict(zip(("turn_x", "turn_y"), turn.tolist()))
            hypotheses = (replace(rotation, patch=patch), place, corners)
        found.append(TaskFinding(hypotheses, one.log_bayes_factor, "meeting"))
    return found


def resolve_conflicts(findings: list[TaskFinding], surfaces: SurfaceContactResult | None) -> list[TaskFinding]:
    """Findings that do not contradict one another.

    The hand feels the table, which the camera does not move: a camera hypothesis that places the table elsewhere is dropped, and one that places
    it there stands alone and counts once. A camera that the view stage still reports explains the hand-eye offset in more detail.
    """
    if (
        surfaces is not None
        and surfaces.comparison is not None
        and surfaces.verdict not in ("undetermined", "unexplained")
    ):
        findings = _constrain_by_touch(findings, surfaces)
    if any(one.source == "view" and one.hypotheses[0].module == "camera" for one in findings):
        findings = [one for one in findings if one.source != "meeting"]
    return findings


def _constrain_by_touch(findings: list[TaskFinding], surfaces: SurfaceContactResult) -> list[TaskFinding]:
    touched = {one.hypotheses[0].name for one in surfaces.comparison.findings if len(one.hypotheses) == 1}
    remaining: list[TaskFinding] = []
    for one in findings:
        if one.source == "view":
            possible = tuple(hypothesis for hypothesis in one.hypotheses if not _contradicts(hypothesis, surfaces))
            one = replace(
                one, hypotheses=tuple(hypothesis for hypothesis in possible if hypothesis.name in touched) or possible
            )
        if one.hypotheses:
            remaining.append(one)
    touched_names = {one.hypotheses[0].name for one in remaining if one.source == "touch" and one.is_one_effect}
    again = [
        one
        for one in remaining
        if one.source == "view" and one.is_one_effect and one.hypotheses[0].name in touched_names
    ]
    return [one for one in remaining if one not in again]


def _contradicts(hypothesis: Hypothesis, surfaces: SurfaceContactResult) -> bool:
    bounds = {"table_" + name: value for name, value in surfaces.comparison.bounds.items()}
    return any(
        not (bounds[name].low <= value.high and value.low <= bounds[name].high)
        for name, value in hypothesis.estimates.items()
        if name in bounds and name.removeprefix("table_") not in surfaces.comparison.unidentifiable
    )


def gaussian_log_bayes_factor(value: ValueWithInterval) -> float:
    """Nats by which a number is more probable than zero, with a Gaussian error of its interval."""
    deviation = max((value.high - value.low) / 3.92, 1e-9)
    return float(np.clip(0.5 * (value.value / deviation) ** 2, 0.0, 1e3))

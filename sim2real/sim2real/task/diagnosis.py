"""The diagnosis of camera, keypoints, timing, arm, contact, object and table from recordings of one set-up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.recordings.reading import ContractViolation
from sim2real.recordings.signals import Log
from sim2real.task import findings
from sim2real.task.arm_result import ArmResult
from sim2real.task.camera.diagnosis import CameraDiagnosis, diagnose_camera
from sim2real.task.camera.parameters import EFFECTS, PARAMETERS
from sim2real.task.camera.rest_poses import RestPose
from sim2real.task.contact_force.estimate import ContactForceResult, estimate_friction_and_mass
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.contact_force.readings import read_forces
from sim2real.task.contact_force.tap_slide import find_tap_slides
from sim2real.task.hypotheses import TaskFinding
from sim2real.task.keypoint_noise import KeypointNoise, estimate_keypoint_noise
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.camera_rotation import prefer_rotation_over_translation
from sim2real.task.suite.hand_eye_offset import HandEyeOffset, camera_shift, estimate_hand_eye_offset
from sim2real.task.suite.hand_proximity import mask_touched_images
from sim2real.task.suite.image_latency import ImageLatency, estimate_image_latency
from sim2real.task.suite.object_pose import camera_over_table
from sim2real.task.suite.occlusion import mask_occlusions
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.suite.static_scene import StaticSceneCheck, check_static_scene
from sim2real.task.surface.estimate import SurfaceContactResult, estimate_surfaces

MODULES = ("camera", "keypoints", "timing", "arm", "contact", "object", "table")
NOT_SEEN = "not seen in this recording"
STAGES = {
    "camera": "view",
    "keypoints": "scatter",
    "timing": "lag",
    "contact": "force",
    "object": "force",
    "table": "touch",
}
"""The stage that each module rests on first."""


@dataclass(frozen=True, eq=False)
class TaskRecordings:
    """Recordings of one set-up."""

    tasks: tuple[TaskRecording, ...]
    """Recordings of the task suite."""
    tracks: tuple[KeypointTrack, ...]
    """Keypoints of all recordings."""
    rest_poses: tuple[RestPose, ...]
    """The object at rest, in all recordings."""
    logs: tuple[Log, ...] = ()
    """Joints in all recordings."""


@dataclass(frozen=True, eq=False)
class ModuleResult:
    """The result for one module."""

    module: str
    """Of MODULES."""
    verdict: str
    """identified, ambiguous, no_gap, unexplained or NOT_SEEN."""
    findings: tuple[TaskFinding, ...] = ()
    """What is off."""
    share: float | None = None
    """Share of the sum of all log Bayes factors; None where nothing is off."""
    abstention_reason: str = ""
    """Why there is no verdict, or what nothing explains."""


@dataclass(frozen=True, eq=False)
class TaskDiagnosis:
    """The result of all stages; a stage without data is None."""

    modules: tuple[ModuleResult, ...]
    """A result for each of MODULES."""
    recordings: TaskRecordings
    """What was diagnosed."""
    camera: CameraDiagnosis | None = None
    """Stage `view`: corners of the object at rest."""
    noise: KeypointNoise | None = None
    """Stage `scatter`: scatter of corners at rest."""
    surfaces: SurfaceContactResult | None = None
    """Stage `touch`: surfaces that stop the tip."""
    forces: ContactForceResult | None = None
    """Stage `force`: contact forces."""
    latency: ImageLatency | None = None
    """Stage `lag`: images against the tip."""
    hand_eye: HandEyeOffset | None = None
    """Stage `meeting`: faces that the hand touches, against where they are seen."""
    static_scene: StaticSceneCheck | None = None
    """Stage `untouched`: whether the picture keeps still."""
    abstention_reasons: dict[str, str] = field(default_factory=dict)
    """Why stages abstain, by stage."""
    arm: ArmResult | None = None
    """What `diagnose` found."""

    @property
    def verdict(self) -> str:
        """unexplained, ambiguous, identified, no_gap, or undetermined where no module is seen."""
        found = {one.verdict for one in self.modules}
        order = ("unexplained", "ambiguous", "identified", "no_gap")
        return next((verdict for verdict in order if verdict in found), "undetermined")

    def module(self, name: str) -> ModuleResult:
        """The result of one of MODULES."""
        return self.modules[MODULES.index(name)]


def diagnose_task(
    recordings: TaskRecordings,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
    arm: ArmResult | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> TaskDiagnosis:
    """Every stage that has data.

    camera: the nominal camera; panda: the arm with its own gap; arm: the result of `diagnose`; on_stage: called with the name of each stage. Of
    several recordings of the task suite surfaces are those of the first, forces, faces and delays are of all.
    """
    reasons: dict[str, str] = {}
    tasks, tracks = mask_occlusions(recordings.tasks, recordings.tracks, camera)
    recordings = replace(recordings, tasks=tasks, tracks=tracks)
    result = TaskDiagnosis((), recordings, abstention_reasons=reasons, arm=arm)

    def try_stage(name: str, stage: Callable):
        on_stage(name)
        try:
            found = stage()
        except ContractViolation as violation:
            reasons[name] = str(violation)
            return None
        if getattr(found, "abstention_reason", ""):
            reasons[name] = found.abstention_reason
        return found

    noise = try_stage("scatter", lambda: _keypoint_noise(recordings, camera))
    viewed = None
    if recordings.rest_poses:
        viewed = try_stage("view", lambda: diagnose_camera(recordings.rest_poses, camera))
    else:
        reasons["view"] = "the object rests nowhere in the picture"
    result = replace(result, noise=noise, camera=viewed)
    if recordings.tasks:
        result = _diagnose_contact(result, camera, panda, try_stage)
    else:
        no_suite = "no recording is of the task suite (excite --suite task)"
        reasons |= dict.fromkeys(("touch", "force", "meeting", "lag"), no_suite)
    found = findings.resolve_conflicts(
        findings.camera_findings(result.camera)
        + findings.keypoint_noise_findings(result.noise)
        + findings.contact_findings(result.surfaces, "touch")
        + findings.contact_findings(result.forces, "force")
        + findings.hand_eye_offset_findings(result.hand_eye, _camera_rotation(result))
        + findings.latency_findings(result.latency),
        result.surfaces,
    )
    return replace(result, modules=tuple(_module_result(module, found, result) for module in MODULES))


def _diagnose_contact(result: TaskDiagnosis, camera: Camera, panda: PandaModel, try_stage: Callable) -> TaskDiagnosis:
    """The stages that need the task suite. Heights are seen over the table as it was touched."""
    tasks = result.recordings.tasks
    first = tasks[0]
    surfaces = try_stage("touch", lambda: estimate_surfaces(first, panda))
    lift = surfaces.lift if surfaces is not None else 0.0
    over = camera_over_table(camera, lift)
    hand_eye = try_stage("meeting", lambda: estimate_hand_eye_offset(tasks, over))

    def forces() -> ContactForceResult:
        readings = [reading for task in tasks for reading in read_forces(task, panda, over)]
        slides = find_tap_slides(first, hand_eye, over) if hand_eye is not None else ()
        return estimate_friction_and_mass(readings, NominalContact.of(first.domain), slides)

    return replace(
        result,
        surfaces=surfaces,
        hand_eye=hand_eye,
        forces=try_stage("force", forces),
        static_scene=try_stage("untouched", lambda: check_static_scene(first, over, lift, result.noise)),
        latency=try_stage("lag", lambda: estimate_image_latency(tasks, over)),
    )


def _camera_rotation(result: TaskDiagnosis) -> np.ndarray | None:
    """Rotation (2,) rad of the camera, where it explains a picture that is off better than its place does; else None."""
    camera, offset = result.camera, result.hand_eye
    if offset is None or offset.comparison is None or not offset.comparison.findings:
        return None
    if camera is None or camera.nominal is None:
        return None
    estimates = offset.comparison.findings[0].hypotheses[0].estimates
    off = np.array([estimates[axis].value for axis in "xy"])
    lift = result.surfaces.lift if result.surfaces is not None else 0.0
    return prefer_rotation_over_translation(camera.scene, camera.nominal.poses, off, lift)


def make_patch(diagnosis: TaskDiagnosis) -> Patch:
    """Findings of one effect that a simulator models, within the bounds of their parameters; none of a module that is unexplained.

    Of a picture or its time the likeliest cause stands for its rivals: where it was looked at, the picture is off either way.
    """
    return _patch([one for one in diagnosis.modules if one.verdict != "unexplained"])


def make_doubtful_patch(diagnosis: TaskDiagnosis) -> Patch:
    """What may help beside `make_patch`: findings of modules that are unexplained, and a camera that is off by less than is named."""
    found = _patch([one for one in diagnosis.modules if one.verdict == "unexplained"])
    given = {e.effect for e in (*make_patch(diagnosis).effects, *found.effects)}
    offset = _unnamed_offset(diagnosis.hand_eye)
    if not offset or "camera_extrinsics" in given:
        return found
    return Patch((*found.effects, PatchEffect("camera_extrinsics", "camera", offset)))


def _unnamed_offset(hand_eye: HandEyeOffset | None) -> dict[str, float]:
    """m by which the camera stands elsewhere, by axis, where that is not named and its interval leaves zero out."""
    if hand_eye is None or hand_eye.comparison is None or hand_eye.comparison.findings:
        return {}
    return camera_shift({n: v for n, v in hand_eye.comparison.bounds.items() if not v.low <= 0 <= v.high})


def _patch(modules: Sequence[ModuleResult]) -> Patch:
    entries: dict[str, dict[str, float]] = {}
    for one in (finding for result in modules for finding in result.findings):
        best = one.hypotheses[0]
        if best.patch and (one.source in ("view", "lag", "meeting") or one.is_one_effect):
            entries.setdefault(best.effects[0], {}).update(best.patch)
    found = (PatchEffect(effect, "", values) for effect, values in entries.items())
    return Patch(tuple(PatchEffect(e.effect, str(e.definition.target), _clip(e)) for e in found))


def _clip(entry: PatchEffect) -> dict[str, float]:
    """Parameters within the bounds of their quantities."""
    bounds = {q.name: (q.lower, q.upper) for q in entry.definition.quantities}
    return {name: float(min(max(value, bounds[name][0]), bounds[name][1])) for name, value in entry.parameters.items()}


def _module_result(module: str, found: list[TaskFinding], diagnosis: TaskDiagnosis) -> ModuleResult:
    if module == "arm" and diagnosis.arm is not None:
        return ModuleResult(module, diagnosis.arm.verdict)
    own = tuple(one for one in found if one.hypotheses[0].module == module)
    total = sum(one.log_bayes_factor for one in found)
    share = sum(one.log_bayes_factor for one in own) / total if own and total else None
    stages = {
        "camera": (diagnosis.camera, diagnosis.hand_eye, diagnosis.static_scene),
        "table": (diagnosis.surfaces,),
        "contact": (diagnosis.forces,),
    }.get(module, ())
    unexplained = [one.abstention_reason for one in stages if one is not None and one.verdict == "unexplained"]
    if unexplained:
        return ModuleResult(module, "unexplained", own, share, "; ".join(unexplained))
    if own:
        return ModuleResult(module, "identified" if all(one.is_one_effect for one in own) else "ambiguous", own, share)
    if _is_observable(module, diagnosis):
        return ModuleResult(module, "no_gap")
    return ModuleResult(module, NOT_SEEN, abstention_reason=_reason(module, diagnosis))


OBSERVED_BY = {
    "camera": ("camera_place", "camera_turn", "focal_length"),
    "object": ("object_size",),
    "table": ("table_height",),
}
"""Effects of the camera stage by which a gap of a module would show."""


def _is_observable(module: str, diagnosis: TaskDiagnosis) -> bool:
    """Whether a gap of the module would have shown."""
    camera, hand_eye, surfaces = diagnosis.camera, diagnosis.hand_eye, diagnosis.surfaces
    clear: set[str] = set()
    if camera is not None and camera.verdict in ("no_gap", "identified", "ambiguous"):
        clear = set(camera.bounds) - set(camera.unidentifiable)
    by_camera = any(
        PARAMETERS[index].name in clear for name in OBSERVED_BY.get(module, ()) for index in EFFECTS[name].numbers
    )
    measured = (diagnosis.forces.measured or {}) if diagnosis.forces else {}
    return {
        "camera": by_camera or (hand_eye is not None and hand_eye.verdict not in ("undetermined", "unexplained")),
        "keypoints": diagnosis.noise is not None,
        "timing": diagnosis.latency is not None and diagnosis.latency.late is not None,
        "arm": False,
        "contact": "table" in measured,
        "object": "mass" in measured or by_camera,
        "table": by_camera or (surfaces is not None and surfaces.comparison is not None),
    }[module]


def _reason(module: str, diagnosis: TaskDiagnosis) -> str:
    if module == "arm":
        return "`diagnose` judges the arm, by a suite of its own; --arm takes its result"
    return diagnosis.abstention_reasons.get(STAGES[module], "the recording narrows none of its numbers")


def _keypoint_noise(recordings: TaskRecordings, camera: Camera) -> KeypointNoise | None:
    """From the longest track. Of the task suite only images count in which the hand is away: a pressed object may rock and seem to rest."""
    if not recordings.tracks:
        return None
    longest = max(recordings.tracks, key=lambda track: len(track.time))
    own = next((task for task in recordings.tasks if task.track.name == longest.name), None)
    return estimate_keypoint_noise(mask_touched_images(own, camera) if own else longest)

"""Recordings of one set-up, all stages that they have data for, and the row of each module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.recordings.reading import ContractViolation
from sim2real.task import findings as made
from sim2real.task.arm_result import ArmResult
from sim2real.task.camera.diagnosis import CameraDiagnosis, diagnose_camera
from sim2real.task.camera.parameters import EFFECTS, PARAMETERS
from sim2real.task.camera.rest_poses import RestPose
from sim2real.task.contact_force.estimate import ContactForceResult, estimate_friction_and_mass
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.contact_force.readings import read_forces
from sim2real.task.contact_force.tap_slide import find_tap_slides
from sim2real.task.findings import Finding
from sim2real.task.keypoint_noise import KeypointNoise, estimate_keypoint_noise
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.camera_rotation import prefer_rotation_over_translation
from sim2real.task.suite.hand_eye_offset import HandEyeOffset, estimate_hand_eye_offset
from sim2real.task.suite.hand_proximity import mask_touched_images
from sim2real.task.suite.image_latency import ImageLatency, estimate_image_latency
from sim2real.task.suite.object_pose import camera_over_table
from sim2real.task.suite.occlusion import mask_occlusions
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.suite.static_scene import StaticSceneCheck, check_static_scene
from sim2real.task.surface.estimate import SurfaceContactResult, estimate_surfaces

MODULES = ("camera", "keypoints", "timing", "arm", "contact", "object", "table")
NOT_SEEN = "not seen in this recording"
OnStage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class TaskRecordings:
    """What recordings of one set-up have: those of the task suite, all tracks of keypoints, and places at which the object rested."""

    tasks: tuple[TaskRecording, ...]
    tracks: tuple[KeypointTrack, ...]
    places: tuple[RestPose, ...]


@dataclass(frozen=True, eq=False)
class ModuleResult:
    """A module. verdict: identified, ambiguous (effects that explain the same), no_gap, unexplained, or `NOT_SEEN`; claims: what is off;
    share: of all nats that what is off explains, None where nothing is; doubt: why nothing is said, or what nothing explains; said: sentences
    of answers that were given elsewhere."""

    module: str
    verdict: str
    claims: tuple[Finding, ...] = ()
    share: float | None = None
    doubt: str = ""
    said: str = ""


@dataclass(frozen=True, eq=False)
class TaskDiagnosis:
    """The answer: a row each module, and each stage's own, None where there is no data for it. arm: what `diagnose_task` answered."""

    rows: tuple[ModuleResult, ...]
    seen: TaskRecordings
    view: CameraDiagnosis | None = None
    scatter: KeypointNoise | None = None
    touch: SurfaceContactResult | None = None
    force: ContactForceResult | None = None
    lag: ImageLatency | None = None
    meeting: HandEyeOffset | None = None
    still: StaticSceneCheck | None = None
    doubts: dict[str, str] = field(default_factory=dict)
    arm: ArmResult | None = None

    @property
    def verdict(self) -> str:
        """unexplained, identified, ambiguous, no_gap, or undetermined where no module is seen."""
        found = {row.verdict for row in self.rows}
        order = ("unexplained", "ambiguous", "identified", "no_gap")
        return next((verdict for verdict in order if verdict in found), "undetermined")

    def row(self, module: str) -> ModuleResult:
        """Of a module."""
        return self.rows[MODULES.index(module)]


def diagnose_task(
    seen: TaskRecordings,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
    arm: ArmResult | None = None,
    tell: OnStage = lambda stage: None,
) -> TaskDiagnosis:
    """Every stage that has data. camera: that is believed in; panda: the arm with its own gap; arm: the answer of `diagnose_task`; tell: hears each stage's name as it begins.

    Of several recordings of the task suite the first is felt by touch, forces are taken together, and delays are those of the first.
    """
    doubts: dict[str, str] = {}
    tasks, tracks = mask_occlusions(seen.tasks, seen.tracks, camera)
    seen = replace(seen, tasks=tasks, tracks=tracks)
    tell("scatter")
    scattered = _tried(doubts, "scatter", lambda: _scattered(seen, camera))
    tell("view")
    viewed = _tried(doubts, "view", lambda: diagnose_camera(seen.places, camera)) if seen.places else None
    if not seen.places:
        doubts["view"] = "the object rests nowhere in the picture"
    touched = forced = late = met = still = None
    if seen.tasks:
        tell("touch")
        touched = _tried(doubts, "touch", lambda: estimate_surfaces(seen.tasks[0], panda))
        lift = touched.lift if touched is not None else 0.0
        felt = camera_over_table(camera, lift)
        tell("meeting")
        met = _tried(doubts, "meeting", lambda: estimate_hand_eye_offset(seen.tasks[0], felt))
        tell("force")
        every = _tried(doubts, "force", lambda: [r for task in seen.tasks for r in read_forces(task, panda, felt)])
        slid = find_tap_slides(seen.tasks[0], met, felt) if met is not None else ()
        forced = (
            estimate_friction_and_mass(every, NominalContact.of(seen.tasks[0].domain), slid)
            if every is not None
            else None
        )
        still = _tried(doubts, "untouched", lambda: check_static_scene(seen.tasks[0], felt, lift, scattered))
        tell("lag")
        late = _tried(doubts, "lag", lambda: estimate_image_latency(seen.tasks[0], felt))
    else:
        doubts |= dict.fromkeys(
            ("touch", "force", "meeting", "lag"), "no recording is of the task suite (excite --suite task)"
        )
    for name, stage in (
        ("view", viewed),
        ("touch", touched),
        ("force", forced),
        ("meeting", met),
        ("untouched", still),
        ("lag", late),
    ):
        if stage is not None and stage.doubt:
            doubts[name] = stage.doubt
    claims = made.resolve_conflicts(
        made.camera_findings(viewed)
        + made.keypoint_noise_findings(scattered)
        + made.contact_findings(touched, "touch")
        + made.contact_findings(forced, "force")
        + made.hand_eye_offset_findings(met, _turned(viewed, met, touched))
        + made.latency_findings(late),
        touched,
    )
    whole = TaskDiagnosis((), seen, viewed, scattered, touched, forced, late, met, still, doubts, arm)
    total = sum(claim.gain for claim in claims)
    rows = tuple(_row(module, [c for c in claims if c.ways[0].module == module], total, whole) for module in MODULES)
    return replace(whole, rows=rows)


def _turned(
    viewed: CameraDiagnosis | None, met: HandEyeOffset | None, touched: SurfaceContactResult | None
) -> np.ndarray | None:
    """rad (2,) by which the camera is turned, where a picture that is off is so by that; None where it is not, or nobody knows."""
    if met is None or met.explained is None or not met.explained.named or viewed is None or viewed.nominal is None:
        return None
    sizes = met.explained.named[0].sizes
    off = np.array([sizes[axis].value for axis in "xy"])
    return prefer_rotation_over_translation(
        viewed.scene, viewed.nominal.poses, off, touched.lift if touched is not None else 0.0
    )


def make_patch(whole: TaskDiagnosis) -> Patch:
    """What is one effect and a simulator carries, within what it takes."""
    entries: dict[str, dict[str, float]] = {}
    for row in whole.rows:
        for claim in row.claims:
            way = claim.ways[0]
            # A late image is late either way, and a picture that is off is off, where it was looked at, by whichever of place and turn.
            is_told = claim.stage in ("lag", "meeting") or claim.is_one
            if row.verdict != "unexplained" and is_told and way.parameters:
                entries.setdefault(way.ids[0], {}).update(way.parameters)
    found = (PatchEffect(effect, "", values) for effect, values in entries.items())
    return Patch(tuple(PatchEffect(e.effect, str(e.definition.target), _held(e)) for e in found))


def _held(entry: PatchEffect) -> dict[str, float]:
    """Parameters within the bounds of their quantities."""
    bounds = {q.name: (q.lower, q.upper) for q in entry.record.quantities}
    return {name: float(min(max(value, bounds[name][0]), bounds[name][1])) for name, value in entry.parameters.items()}


def _row(module: str, claims: list[Finding], total: float, whole: TaskDiagnosis) -> ModuleResult:
    doubt, stage = _unexplained(module, whole)
    share = sum(c.gain for c in claims) / total if claims and total else None
    if module == "arm" and whole.arm is not None:
        return ModuleResult(module, whole.arm.verdict, said=whole.arm.said)
    if stage:
        return ModuleResult(module, "unexplained", tuple(claims), share, doubt)
    if claims:
        verdict = "identified" if all(c.is_one for c in claims) else "ambiguous"
        return ModuleResult(module, verdict, tuple(claims), share)
    if _is_seen(module, whole):
        return ModuleResult(module, "no_gap")
    return ModuleResult(module, NOT_SEEN, doubt=_why(module, whole))


def _unexplained(module: str, whole: TaskDiagnosis) -> tuple[str, bool]:
    """Of the module that a stage is first of all about."""
    stages = {
        "camera": (whole.view, whole.meeting, whole.still),
        "table": (whole.touch,),
        "contact": (whole.force,),
    }.get(module, ())
    doubts = [stage.doubt for stage in stages if stage is not None and stage.verdict == "unexplained"]
    return "; ".join(doubts), bool(doubts)


def _is_seen(module: str, whole: TaskDiagnosis) -> bool:
    """Whether a gap of it would have shown."""
    bounds = whole.view.bounds if whole.view and whole.view.verdict in ("no_gap", "identified", "ambiguous") else {}
    clear = {name for name in bounds if name not in whole.view.unseen} if whole.view else set()
    forces = (whole.force.measured or {}) if whole.force else {}
    is_touched = whole.touch is not None and whole.touch.explained is not None
    by_view = {m: any(PARAMETERS[i].name in clear for e in es for i in EFFECTS[e].numbers) for m, es in _VIEWED.items()}
    return {
        "camera": by_view["camera"]
        or (whole.meeting is not None and whole.meeting.verdict not in ("undetermined", "unexplained")),
        "keypoints": whole.scatter is not None,
        "timing": whole.lag is not None and whole.lag.late is not None,
        "arm": False,
        "contact": "table" in forces,
        "object": "mass" in forces or by_view["object"],
        "table": is_touched or by_view["table"],
    }[module]


_VIEWED = {
    "camera": ("camera_place", "camera_turn", "focal_length"),
    "object": ("object_size",),
    "table": ("table_height",),
}


def _why(module: str, whole: TaskDiagnosis) -> str:
    stage = {
        "camera": "view",
        "keypoints": "scatter",
        "timing": "lag",
        "contact": "force",
        "object": "force",
        "table": "touch",
    }
    if module == "arm":
        return "the arm is asked by `diagnose_task`, of a suite of its own; --arm takes its answer"
    return whole.doubts.get(stage[module], "the recording narrows none of its numbers")


def _scattered(seen: TaskRecordings, camera: Camera) -> KeypointNoise | None:
    """Of the longest track; of one of the task suite, while the hand is not at the object: what it presses may rock, and seem to rest."""
    if not seen.tracks:
        return None
    longest = max(seen.tracks, key=lambda track: len(track.time))
    own = next((task for task in seen.tasks if task.track.name == longest.name), None)
    return estimate_keypoint_noise(mask_touched_images(own, camera) if own else longest)


def _tried(doubts: dict[str, str], stage: str, ask: Callable):
    """A stage's answer; None where its recording has too little for it, which is kept in words."""
    try:
        return ask()
    except ContractViolation as violation:
        doubts[stage] = str(violation)
        return None

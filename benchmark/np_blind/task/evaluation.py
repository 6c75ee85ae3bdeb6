"""Recording, diagnosis and score of a task case."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch
from sim2real.report.task_sentences import finding_text
from sim2real.task.camera.rest_poses import find_rest_poses
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.diagnosis import TaskDiagnosis, TaskRecordings, diagnose_task
from sim2real.task.hypotheses import module_of
from sim2real.task.object_motion.patch_check import CheckedPatch, check_patch
from sim2real.task.object_motion.prediction import estimate_removed_share, prediction_errors
from sim2real.task.object_motion.windows import FAMILIES
from sim2real.task.suite.object_pose import camera_over_table, pose_between
from sim2real.task.suite.occlusion import mask_occluded_keypoints
from sim2real.task.suite.recording import TaskRecording

from np_blind.task.cases import TaskCase
from np_blind.task.joint_fit import at_once
from np_blind.task.simulated_lab import SimulatedLab
from np_description.camera import CAMERA
from np_description.domains import BUMP

HELD_OUT = 500_000  # added to the seed of a recording that no stage gets: other starts, other noise, the same set-up
FELT_FIRST = "touch_object"  # so that drags press as they should


def answer(case: TaskCase, seed: int) -> dict:
    """Record, diagnose and score a case."""
    begun = time.perf_counter()
    recording = mask_occluded_keypoints(record_case(case, seed))
    fresh = record_case(case, seed + HELD_OUT, (FELT_FIRST, *FAMILIES))
    made = time.perf_counter()
    rests = tuple(place for place, _ in find_rest_poses(recording.track, recording.domain))
    found = diagnose_task(TaskRecordings((recording,), (recording.track,), rests))
    asked = time.perf_counter()
    kept = check_patch([recording], found)
    moved = held_out_motion(case, found, kept, [fresh])
    done = time.perf_counter()
    took = {"made_s": made - begun, "asked_s": asked - made, "moved_s": done - asked}
    return {
        **score_diagnosis(case, found),
        "withheld": list(kept.withheld),
        "added": list(kept.added),
        "motion": moved,
        **took,
    }


def record_case(case: TaskCase, seed: int, only: tuple[str, ...] = ()) -> TaskRecording:
    """The task suite, or some of its families, of a case in PhysX; up to where its guard ends it."""
    from np_physx_bridge.engine import PhysxEngine  # where SAPIEN is

    class Pulled(PhysxEngine):
        """PhysX with a cable on the object, or a magnet under the table."""

        def step(self, torque, extra, opening) -> None:
            """As in Engine."""
            place = self.object.entity.pose.p
            if force := external_force(case, place):
                self.object.add_force_at_point(np.array(force), place)
            super().step(torque, extra, opening)

    own = seed * 1000 + case.number
    return SimulatedLab(BUMP, case.patch, own, Pulled, case.film(own), case.domain).run(only, is_cut=True)


def external_force(case: TaskCase, place: Sequence[float]) -> tuple[float, float, float] | None:
    """N on the object at a place m, by what is out of the catalogue."""
    if pull := case.stranger("cable", "pull"):
        way = case.stranger("cable", "way")
        return pull * float(np.cos(way)), pull * float(np.sin(way)), 0.0
    if pull := case.stranger("magnet", "pull"):
        away = np.hypot(place[0] - case.stranger("magnet", "x"), place[1] - case.stranger("magnet", "y"))
        return 0.0, 0.0, -pull / (1.0 + (float(away) / MAGNET) ** 2)
    return None


MAGNET = 0.05  # m from a magnet at which its pull is half


def score_diagnosis(case: TaskCase, found: TaskDiagnosis) -> dict:
    """The score of a diagnosis."""
    findings = [one for result in found.modules for one in result.findings]
    named = [sorted({one for way in finding.hypotheses for one in way.effects}) for finding in findings]
    modules = sorted({one.module for one in found.modules if one.findings or one.verdict == "unexplained"})
    hits = [effect for effect in case.effects if any(effect in ids for ids in named)]
    wrong = sum(not set(case.effects) & set(ids) for ids in named)
    return {
        "case": case.number,
        "kind": case.kind,
        "gap": case.gap,
        "verdict": found.verdict,
        "rows": {one.module: one.verdict for one in found.modules},
        "named": named,
        "said": [finding_text(one) for one in findings],
        "doubts": found.abstention_reasons,
        "module": modules == sorted({module_of(e) for e in case.effects}) if case.effects else None,
        "found": hits,
        "effect": len(hits) == len(case.effects) and not wrong if case.effects else None,
        "wrong": wrong,
        "unexplained": found.verdict == "unexplained",
        "intervals": _intervals(case, found),
        "at_once": at_once(found).named,
    }


def held_out_motion(case: TaskCase, found: TaskDiagnosis, kept: CheckedPatch, fresh: Sequence[TaskRecording]) -> dict:
    """px by which corners are seen off their prediction, mean over the windows of recordings that no stage has used: nominal, with the
    patch that is given, with all that is true, and with everything that was measured, named or not. Empty without a window."""
    tried = {"believed": Patch(), "patch": kept.patch, "truth": case.patch, "at_once": at_once(found).patch}
    off: dict[str, np.ndarray] = {}
    for name, one in tried.items():  # what is the same is simulated once
        same = next((other for other in off if tried[other] == one), None)
        off[name] = prediction_errors(fresh, one) if same is None else off[same]
    known = np.all([np.isfinite(values) for values in off.values()], axis=0)
    if not known.any():
        return {}
    removed = estimate_removed_share(off["believed"][known], off["patch"][known])
    return {
        "windows": int(known.sum()),
        "lost": int((~known).sum()),
        **{name: float(values[known].mean()) for name, values in off.items()},
        "removed": [removed.value, removed.low, removed.high],
    }


def _shown_off(recording: TaskRecording, patch: Patch) -> list[float]:
    """m (x, y) by which the true camera shows the object's middle elsewhere than it is, where it rests at first."""
    lift = patch.scene_change().lift
    place = pose_between(
        recording, recording.seen_from, recording.seen_from + 1.0, camera_over_table(CAMERA, lift)
    ).position
    place = np.array([*place[:2], lift + BUMP.half_size[2]])
    shown = CAMERA.at_height(CAMERA.rays(CameraEffects(patch).camera.project(place[None])[0]), place[2])
    return (np.asarray(shown).ravel()[:2] - place[:2]).tolist()


def _intervals(case: TaskCase, found: TaskDiagnosis) -> dict[str, dict]:
    """Every number that was measured beside the truth, its background included."""
    patch, believed = case.patch, NominalContact.of(BUMP)
    change = patch.scene_change()
    truths = {
        "table": believed.table * change.table,
        "finger": believed.finger * change.finger,
        "mass": believed.mass * change.mass,
    }
    measured = {}
    if found.forces and found.forces.measured:
        measured |= {name: (truths[name], *values) for name, values in found.forces.measured.items()}
    if found.surfaces and found.surfaces.comparison and "height" in found.surfaces.comparison.bounds:
        value = found.surfaces.comparison.bounds["height"]
        measured["height"] = (change.lift, value.value, value.low, value.high)
    if found.latency and found.latency.late:
        late = sum(e.get("delay") for e in patch.of("camera_latency"))
        measured["late"] = (late, found.latency.late.value, found.latency.late.low, found.latency.late.high)
    if found.hand_eye and found.hand_eye.comparison:
        for axis, off in zip("xy", _shown_off(found.recordings.tasks[0], patch)):
            value = found.hand_eye.comparison.bounds[axis]
            measured[f"picture_{axis}"] = off, value.value, value.low, value.high
    if found.forces and found.forces.least_finger is not None:
        measured["least_finger"] = (truths["finger"], found.forces.least_finger, found.forces.least_finger, np.inf)
    return {
        name: {
            "true": true,
            "value": value,
            "low": low,
            "high": high if np.isfinite(high) else None,
            "holds": bool(low <= true <= high),
        }
        for name, (true, value, low, high) in measured.items()
    }

"""What a patch is worth: the object's motion in pushes and taps, predicted in MuJoCo as believed and with the patch, beside what was seen.

The arm is led along its measured way; the object begins where it is seen. None of these pictures had a say in friction or mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Pose
from np_description.keypoints import box_keypoints
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.chain.task.seen import seen_pose
from np_diagnosis.recordings.reading import ContractViolation
from np_effects.patch import Patch
from np_effects.view_effects import ViewEffects
from np_sim_bridge.mujoco_engine import MujocoEngine
from np_sim_bridge.schedule import PERIOD, SECOND

STIFFNESS = np.array([4000.0, 4000, 4000, 4000, 1500, 1500, 1000])  # Nm/rad, by which the arm is led
DAMPING = 2 * np.sqrt(0.2 * STIFFNESS)  # Nm s/rad
FAMILIES = ("push", "tap")
BEFORE = 0.3  # s of the object at rest that are left out: images in which its place is taken


@dataclass(frozen=True)
class Predicted:
    """px, root mean square by which corners are seen off, of all pushes and taps: before, as believed; after, with the patch. experiments: that
    were predicted."""

    before: float
    after: float
    experiments: int

    @property
    def removed(self) -> float:
        """Share of the error that the patch removes; below 0 where it does harm."""
        return 1.0 - self.after / self.before if self.before else 0.0


def predict(recording: TaskRecording, patch: Patch, camera: Camera = CAMERA) -> Predicted | None:
    """Of all pushes and taps of a recording; None where none can be predicted."""
    errors: list[tuple[np.ndarray, np.ndarray]] = []
    for name in (name for family in FAMILIES for name in recording.named(family)):
        try:
            errors.append((_off(recording, name, Patch(), camera), _off(recording, name, patch, camera)))
        except (ContractViolation, FloatingPointError):
            continue
    if not errors:
        return None
    before, after = (float(np.sqrt(np.mean(np.concatenate(of) ** 2))) for of in zip(*errors))
    return Predicted(before, after, len(errors))


def _off(recording: TaskRecording, name: str, patch: Patch, camera: Camera) -> np.ndarray:
    """px (n,), all coordinates of usable corners of an experiment's images against their prediction."""
    change, view = patch.scene_change(), ViewEffects(patch, camera)
    late = sum(e.get("delay") for e in patch.of("camera_latency"))
    # A table that is higher is one from which the camera is less high.
    x, y, z = view.camera.position
    start = change.pose(seen_pose(recording, name, replace(view.camera, position=(x, y, z - change.lift))))
    begin, end = recording.spans[name]
    moments, poses = _simulated(recording, name, change, start)
    images = recording.images(name)
    taken = recording.track.time[images] + recording.seen_from
    found = []
    for image, at in zip(images, taken):
        if not begin + BEFORE < at < end:
            continue
        pose = poses[min(int(np.searchsorted(moments, at - late)), len(poses) - 1)]
        corners = box_keypoints(np.asarray(recording.domain.half_size), pose.position, pose.quaternion)
        usable = recording.track.usable[image]
        found.append((view.lens(view.camera.project(corners)[0]) - recording.track.pixels[image])[usable].ravel())
    if not found:
        raise ContractViolation(f"{name}: expected images of it, got none")
    return np.concatenate(found)


def _simulated(recording: TaskRecording, name: str, change, start: Pose) -> tuple[np.ndarray, list[Pose]]:
    """Moments (n,) s and the object's poses, the arm led along the way that was measured, with the torques that it took."""
    log, rows = recording.log, recording.rows(name)
    engine = MujocoEngine(recording.domain, change=change)
    engine.reset(start)
    engine.place(log.position[rows.start])
    moments = np.arange(log.time[rows.start], log.time[rows.stop - 1], PERIOD / SECOND)
    led, speed, torque = (
        np.column_stack([np.interp(moments, time, column) for column in values.T])
        for time, values in (
            (log.time, log.position),
            (log.time, log.velocity),
            (log.torque_time, log.torque),
        )
    )
    poses = []
    for row in range(len(moments)):
        poses.append(engine.object_pose())
        q, dq, _ = engine.joints()
        pull = STIFFNESS * (led[row] - q[:7]) + DAMPING * (speed[row] - dq[:7])
        engine.step(torque[row] + pull, np.zeros(7), 0.0)
    return moments, poses

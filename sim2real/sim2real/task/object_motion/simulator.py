"""One window of the object's motion in MuJoCo: the hand led along its measured way, with the torques that it took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from np_control.dynamics import Dynamics
from np_description.camera import CAMERA, Camera
from np_description.contact.model import STEADY
from np_description.control_rate import PERIOD_NS, SECOND
from np_description.domains import Pose, Task
from np_description.keypoints import box_keypoints
from np_description.mujoco_engine import MujocoEngine
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch
from sim2real.recordings.reading import ContractViolation
from sim2real.task.object_motion.windows import MotionWindow
from sim2real.task.suite.object_pose import camera_over_table, pose_between
from sim2real.thresholds import THRESHOLDS

MOTION = THRESHOLDS.object_motion
LEAST_CORNERS = 3  # of an image that counts
STIFFNESS = MOTION.stiffness * np.array([4.0, 4, 4, 4, 1.5, 1.5, 1])  # Nm/rad, by which the arm is led
DAMPING = 2 * np.sqrt(0.2 * STIFFNESS)  # Nm s/rad


class WindowSimulator:
    """A set-up with the effects of a patch, in which windows are predicted.

    The hand is led along the way that was measured, softly, so that it presses by the force of its torques: a stiff hand would
    press by what two simulators' contacts give way. Contacts are steady, or a pressed tip that moves would hop. camera: the nominal one; panda: the arm with its own gap; rougher: share by which
    the table's friction is more than in the patch.
    """

    def __init__(
        self,
        domain: Task,
        patch: Patch,
        camera: Camera = CAMERA,
        panda: PandaModel = NOMINAL,
        rougher: float = 0.0,
    ):
        change = patch.scene_change()
        self._change = replace(change, table=(1.0 + rougher) * change.table)
        self._domain, self._view = domain, CameraEffects(patch, camera)
        self._late = sum(e.get("delay") for e in patch.of("camera_latency"))
        self._late += sum(e.get("offset") for e in patch.of("clock_offset"))
        contact = replace(STEADY, hand=domain.contact.hand)
        self._engine = MujocoEngine(domain, panda=panda, contact=contact, change=self._change)
        self._gravity = Dynamics(panda).gravity

    def error(self, window: MotionWindow) -> float:
        """px by which corners are seen off their prediction in a window: see `off`. Raises as `predicted` and `off` do."""
        return self.off(window, self.predicted(window))

    def predicted(self, window: MotionWindow) -> list[Pose]:
        """The object's pose as each image of a window shows it, from where it is seen to rest before.

        Raises ContractViolation where the object is not seen, FloatingPointError where the simulation comes apart.
        """
        recording = window.recording
        start = self._change.pose(pose_between(recording, window.rest_from, window.begin, self._seen_from()))
        moments, poses = self._simulate(window, start)
        shown = recording.track.time[window.images] + recording.seen_from - self._late
        return [poses[k] for k in np.clip(np.searchsorted(moments, shown), 0, len(poses) - 1)]

    def off(self, window: MotionWindow, poses: Sequence[Pose]) -> float:
        """px by which corners are seen off where poses, one an image of the window, have them: root mean square over images of the median
        corner's distance, which a corner that is found wrongly leaves alone. Raises ContractViolation where too few corners are seen."""
        squares = [self._corner_error(window.recording.track, n, pose) for n, pose in zip(window.images, poses)]
        squares = [one for one in squares if one is not None]
        if not squares:
            raise ContractViolation(f"{window.experiment}: expected images of its motion, got none")
        return float(np.sqrt(np.mean(squares)))

    def _seen_from(self) -> Camera:
        """A table that is higher is one from which the camera is less high."""
        return camera_over_table(self._view.camera, self._change.lift)

    def _corner_error(self, track, image: int, pose: Pose) -> float | None:
        """px^2, of the median corner of an image; None where too few are usable."""
        usable = track.usable[image]
        if usable.sum() < LEAST_CORNERS:
            return None
        corners = box_keypoints(np.asarray(self._domain.half_size), pose.position, pose.quaternion)
        expected = self._view.lens(self._view.camera.project(corners)[0])
        return float(np.median(np.linalg.norm((expected - track.pixels[image])[usable], axis=1)) ** 2)

    def _simulate(self, window: MotionWindow, start: Pose) -> tuple[np.ndarray, list[Pose]]:
        """Moments (n,) s and the object's poses."""
        log, rows, engine = window.recording.log, window.rows, self._engine
        engine.reset(start)
        engine.place(log.position[rows.start], log.velocity[rows.start])
        moments = np.arange(log.time[rows.start], log.time[rows.stop - 1], PERIOD_NS / SECOND)
        joint_positions, speed, torque = (
            np.column_stack([np.interp(moments, time, column) for column in values.T])
            for time, values in ((log.time, log.position), (log.time, log.velocity), (log.torque_time, log.torque))
        )
        if log.with_gravity:
            torque = torque - np.array([self._gravity(q) for q in joint_positions])
        poses = []
        for row in range(len(moments)):
            poses.append(engine.object_pose())
            q, dq, _ = engine.joints()
            pull = STIFFNESS * (joint_positions[row] - q[:7]) + DAMPING * (speed[row] - dq[:7])
            engine.step(torque[row] + pull, np.zeros(7), 0.0)
        return moments, poses

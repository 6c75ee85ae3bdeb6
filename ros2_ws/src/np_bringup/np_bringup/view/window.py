"""MuJoCo's own viewer as a window, where there is a display."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from np_bringup.view.shown_joints import ArmNotNamed, ShownJoints
from np_description.domains import Pose, Task
from np_description.drawing.meshes import load_visual_model
from np_description.message_arrays import pose_arrays
from np_description.panda import BASE_FRAME, STATE_NAMES
from np_description.scene import OBJECT
from np_record.bag import Message, Recording

_PERIOD = 0.05  # s between two pictures
_GOAL = np.array([0.2, 0.8, 0.3, 0.3], np.float32)


@dataclass(frozen=True)
class Moment:
    """The state that a window shows."""

    joints: np.ndarray
    """Arm and fingers (9,) rad and m."""
    body: Pose | None
    """The object; None where it is unknown."""
    goal: Pose | None
    """The goal; None where it is unknown."""


class Window:
    """A window on the scene of a domain; meshes: as in `load_visual_model`.

    Raises OSError where there is no display, or no OpenGL on it.
    """

    def __init__(self, domain: Task, *, meshes: bool | None = None):
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise OSError(
                "--window: expected a display (DISPLAY or WAYLAND_DISPLAY), there is none: leave it out for the page"
            )
        from mujoco import viewer

        self._domain, self._model = domain, load_visual_model(domain.as_rigid_box, meshes=meshes)
        self._data = mujoco.MjData(self._model)
        self._joints = [self._model.joint(name).qposadr[0] for name in STATE_NAMES]
        self._body = self._model.jnt_qposadr[self._model.body(OBJECT).jntadr[0]]
        self._viewer = viewer.launch_passive(self._model, self._data, show_left_ui=False, show_right_ui=False)
        camera = self._viewer.cam  # beside the table, as in the videos of reports
        camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (0.40, 0.0, 0.22), 1.6, 135.0, -21.0

    @property
    def is_open(self) -> bool:
        """Wait until the user closes it."""
        return self._viewer.is_running()

    def show(self, moment: Moment) -> None:
        """Draw a moment; an object of unknown pose is put out of sight."""
        body = moment.body or Pose(np.array([0.0, 0.0, -10.0]), np.array([1.0, 0.0, 0.0, 0.0]))
        with self._viewer.lock():
            self._data.qpos[self._joints] = moment.joints
            self._data.qpos[self._body : self._body + 7] = [*body.position, *body.quaternion]
            mujoco.mj_kinematics(self._model, self._data)
            self._draw(moment.goal)
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()

    def _draw(self, goal: Pose | None) -> None:
        """The goal as a box that one can see through."""
        scene = self._viewer.user_scn
        scene.ngeom = 0 if goal is None else 1
        if goal is not None:
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, goal.quaternion)
            size = np.asarray(self._domain.half_size, float)
            mujoco.mjv_initGeom(scene.geoms[0], mujoco.mjtGeom.mjGEOM_BOX, size, goal.position, turn, _GOAL)


def play(recording: Recording, domain: Task, window: Callable[[Task], Window] = Window) -> None:
    """Play a bag at its own speed, again and again until the window is closed."""
    shown = window(domain)
    try:
        while shown.is_open:
            began = time.monotonic()
            for seconds, moment in moments(recording):
                time.sleep(max(0.0, began + seconds - time.monotonic()))
                if not shown.is_open:
                    break
                shown.show(moment)
    finally:
        shown.close()


def moments(recording: Recording) -> Iterator[tuple[float, Moment]]:
    """(s since the start, moment), twenty a second. Raises BadMessage."""
    body = goal = not_named = None
    due, joints = recording.start, ShownJoints(Message.decode)
    for message in recording.messages("joint_states", "object_pose", "goal_pose"):
        if message.topic.name == "object_pose":
            body = Pose(*pose_arrays(message.decode(), BASE_FRAME))
        elif message.topic.name == "goal_pose":
            goal = Pose(*pose_arrays(message.decode(), BASE_FRAME))
        else:
            joints.add(message)
            if message.stamp < due:
                continue
            try:
                moment = Moment(joints.read()[1], body, goal)
            except ArmNotNamed as error:
                not_named = not_named or error
                continue
            due = message.stamp + round(_PERIOD * 1e9)
            yield (message.stamp - recording.start) / 1e9, moment
    if not_named and due == recording.start:
        raise not_named

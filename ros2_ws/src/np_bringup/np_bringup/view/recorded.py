"""The moments of a bag."""

from __future__ import annotations

import cv2
import numpy as np

from np_description.domains import Pose, pose_error
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import image_array, joint_state_arrays, pose_arrays
from np_description.objects.choice import read_domain
from np_description.panda import BASE_FRAME, STATE_NAMES
from np_record.bag import BagError, Recording
from np_record.recorded_phases import PHASE_TOPICS, read_phase_changes

RATE = 20  # moments a second
_SECOND = 1_000_000_000


class RecordedEpisode:
    """A bag, read once; one moment every 50 ms; meshes: as in `drawn_model`.

    Raises BagError for a path that is none, or has no joint states.
    """

    def __init__(self, path: str, *, meshes: bool | None = None):
        recording = Recording(path, required=("joint_states",))
        self._scene = SceneData(read_domain(recording.information), meshes=meshes)
        self._start = recording.start
        self._moments: list[dict] = []
        self._images: list[tuple[int, bytes]] = []
        collected = {name: [] for name in PHASE_TOPICS}
        pose = goal = None
        due = recording.start
        wanted = ("joint_states", "object_pose", "goal_pose", "camera/image_raw", *PHASE_TOPICS)
        for message in recording.messages(*wanted):
            match message.topic.name:
                case "object_pose":
                    pose = Pose(*pose_arrays(message.decode(), BASE_FRAME))
                case "goal_pose":
                    goal = Pose(*pose_arrays(message.decode(), BASE_FRAME))
                case "camera/image_raw":
                    self._keep_image(message)
                case "joint_states" if message.stamp >= due:
                    self._moments.append(self._moment(message, pose, goal))
                    due = message.stamp + _SECOND // RATE
                case name if name in collected:
                    collected[name].append(message)
        try:
            self._phases = [
                (self._time(stamp), str(state)) for stamp, state in read_phase_changes(str(path), collected)
            ]
        except BagError:  # of the bare arm
            self._phases = []

    def scene(self) -> dict:
        """The shapes to draw, and the kind of source."""
        return {**self._scene.scene(), "live": False, "has_images": bool(self._images)}

    def episode(self) -> dict:
        """moments: time s, poses, distance m and angle rad to the goal (null where unknown); phases: [time s, words]."""
        return {"moments": self._moments, "phases": self._phases}

    def image(self, time: float) -> bytes | None:
        """The JPEG of the newest image at `time` s, None where there is none."""
        stamps = [stamp for stamp, _ in self._images]
        number = int(np.searchsorted(stamps, self._start + time * _SECOND, side="right")) - 1
        return self._images[number][1] if number >= 0 else None

    def _keep_image(self, message) -> None:
        self._images.append((message.stamp, encode_image(image_array(message.decode()))))

    def _moment(self, message, pose: Pose | None, goal: Pose | None) -> dict:
        joints = joint_state_arrays(message.decode(), STATE_NAMES)[0]
        return {"time": self._time(message.stamp), "poses": self._scene.poses(joints, pose, goal), **error(pose, goal)}

    def _time(self, stamp: int) -> float:
        return round((stamp - self._start) / _SECOND, 3)


def error(pose: Pose | None, goal: Pose | None) -> dict:
    """Distance and angle of the object to its goal, by the true pose where there is one."""
    if pose is None or goal is None:
        return {"distance": None, "angle": None}
    distance, angle = pose_error(pose.position, pose.quaternion, goal.position, goal.quaternion)
    return {"distance": round(float(distance), 4), "angle": round(float(angle), 4)}


def encode_image(pixels: np.ndarray) -> bytes:
    """An image (height, width, 3) uint8 RGB as JPEG."""
    return cv2.imencode(".jpg", pixels[:, :, ::-1])[1].tobytes()

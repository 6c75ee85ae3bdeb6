"""The moments of a bag."""

from __future__ import annotations

import cv2
import numpy as np

from np_bringup.view.shown_joints import ArmNotNamed, ShownJoints
from np_description.control_rate import SECOND
from np_description.domains import Pose, pose_error
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import image_array, pose_arrays
from np_description.objects.choice import read_domain
from np_description.panda import BASE_FRAME
from np_record.bag import BagError, Message, Recording
from np_record.recorded_phases import PHASE_TOPICS, read_phase_changes

RATE = 20  # moments a second


class RecordedEpisode:
    """A bag, read once; one moment every 50 ms; meshes: as in `drawn_model`.

    Raises BagError for a path that is none, or has no joint states; BadMessage for messages that cannot be read, or never name the arm's
    joints.
    """

    def __init__(self, path: str, *, meshes: bool | None = None):
        recording = Recording(path, required=("joint_states",))
        self._scene = SceneData(read_domain(recording.information), meshes=meshes)
        self._start = recording.start
        self._moments: list[dict] = []
        self._images: list[tuple[int, bytes]] = []
        collected = {name: [] for name in PHASE_TOPICS}
        pose = goal = None
        due, joints, not_named = recording.start, ShownJoints(Message.decode), None
        wanted = ("joint_states", "object_pose", "goal_pose", "camera/image_raw", *PHASE_TOPICS)
        for message in recording.messages(*wanted):
            match message.topic.name:
                case "object_pose":
                    pose = Pose(*pose_arrays(message.decode(), BASE_FRAME))
                case "goal_pose":
                    goal = Pose(*pose_arrays(message.decode(), BASE_FRAME))
                case "camera/image_raw":
                    self._keep_image(message)
                case "joint_states":
                    joints.add(message)
                    if message.stamp < due:
                        continue
                    try:
                        self._moments.append(self._moment(message.stamp, joints.read()[1], pose, goal))
                        due = message.stamp + SECOND // RATE
                    except ArmNotNamed as error:
                        not_named = error
                case name if name in collected:
                    collected[name].append(message)
        if not_named and not self._moments:
            raise not_named
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
        """moments: time s, poses, distance m and angle rad to the goal (null where unknown); phases: [time s, text]."""
        return {"moments": self._moments, "phases": self._phases}

    def image(self, time: float) -> bytes | None:
        """The JPEG of the newest image at `time` s, None where there is none."""
        stamps = [stamp for stamp, _ in self._images]
        number = int(np.searchsorted(stamps, self._start + time * SECOND, side="right")) - 1
        return self._images[number][1] if number >= 0 else None

    def _keep_image(self, message) -> None:
        self._images.append((message.stamp, encode_image(image_array(message.decode()))))

    def _moment(self, stamp: int, joints: np.ndarray, pose: Pose | None, goal: Pose | None) -> dict:
        return {"time": self._time(stamp), "poses": self._scene.poses(joints, pose, goal), **error(pose, goal)}

    def _time(self, stamp: int) -> float:
        return round((stamp - self._start) / SECOND, 3)


def error(pose: Pose | None, goal: Pose | None) -> dict:
    """Distance and angle of the object to its goal, by the true pose where there is one."""
    if pose is None or goal is None:
        return {"distance": None, "angle": None}
    distance, angle = pose_error(pose.position, pose.quaternion, goal.position, goal.quaternion)
    return {"distance": round(float(distance), 4), "angle": round(float(angle), 4)}


def encode_image(pixels: np.ndarray) -> bytes:
    """An image (height, width, 3) uint8 RGB as JPEG."""
    return cv2.imencode(".jpg", pixels[:, :, ::-1])[1].tobytes()

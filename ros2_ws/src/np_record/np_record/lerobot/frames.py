"""A recorded episode as frames: one for each tick of the policies, from the first image after its start to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from np_description.domains import Pose, Task
from np_description.message_arrays import gains_array, image_array, keypoints_array, pose_arrays
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.phases import ACTIVE, PRE, SUCCEEDED, first_end
from np_record.bag import BagError, Recording
from np_record.bulk import read_joint_states
from np_record.lerobot.layout import ACTION, DONE, GOAL, KEYPOINTS, OBJECT, PHASE, STATE, SUCCESS, TARGET, TORQUE
from np_record.outcome import score_outcome
from np_record.recorded_episode import read_recorded_task
from np_record.recorded_phases import PHASE_TOPICS, read_phase_changes

RATE = 10
"""Frames a second: the policies' rate. There is always an image at a policy's tick, whatever the camera's rate."""

TASKS = {
    "card": "Slide the card on the table to the goal pose",
    "bump": "Tumble the cube onto the face and to the place of the goal pose, over or beside the bump",
    "wall": "Push the box up the wall and lay it down at the goal position",
}
_SECOND, _ROUNDING = 1_000_000_000, 2_000_000  # ns; stamps of images are rounded to the control period
_POSE = tuple("x y z qw qx qy qz".split())
_POSES = ("object_pose", "goal_pose", "target_pose")

NAMES: dict[str, tuple[str, ...]] = {
    STATE: tuple(f"{joint}.{what}" for what in ("position", "velocity", "effort") for joint in STATE_NAMES),
    KEYPOINTS: tuple(f"corner_{number}.{what}" for number in range(8) for what in ("u", "v", "score")),
    OBJECT: _POSE,
    GOAL: _POSE,
    ACTION: tuple(f"{joint}.target" for joint in JOINT_NAMES),
    TORQUE: tuple(f"{joint}.torque" for joint in JOINT_NAMES),
    TARGET: (
        *_POSE,
        *(f"{joint}.{what}" for what in ("stiffness", "damping_ratio") for joint in JOINT_NAMES),
    ),
    PHASE: ("phase",),
    DONE: ("done",),
    SUCCESS: ("success",),
}
"""Features by name, and what each number of one is."""


@dataclass(frozen=True, eq=False)
class EpisodeFrames:
    """One episode of n frames."""

    domain: Task
    """Its task."""
    success: bool
    """Whether the object came to its goal."""
    columns: dict[str, np.ndarray]
    """(n, numbers) by feature."""
    images: np.ndarray
    """(n, height, width, 3) uint8, (0, ...) where no camera was recorded."""

    def __len__(self) -> int:
        return len(self.columns[STATE])

    @property
    def task(self) -> str:
        """What was to be done, as a sentence."""
        return TASKS[self.domain.name]


def read_episode_frames(recording: Recording) -> EpisodeFrames:
    """The first episode of a recording. Raises BagError where a frame lacks something.

    A frame has the newest message of each topic whose stamp is not after its own. `action` and `command.effort` are the
    last command before the next frame: where the joints were to be by then, and with what torque. `policy.target` is
    the policy's output for the frame, zeros where there is none. `observation.environment_state` is left out
    where the recording has no `object_pose`: on a real arm. With it the truth at the end decides the success, as in reports.
    """
    where = f"bag {recording.path}"
    joints = recording.rows("joint_states", "effort_command")
    states, state = read_joint_states(where, joints.get("joint_states"), STATE_NAMES)
    orders, order = read_joint_states(where, joints.get("effort_command"), JOINT_NAMES)
    changes = read_phase_changes(where, recording.rows(*PHASE_TOPICS))
    began = next((stamp for stamp, state in changes if state.phase == PRE), None)
    if began is None:
        raise BagError(f"{where}: expected an episode, phase {PRE} was never published")
    changes = [change for change in changes if change[0] >= began]
    end = first_end([state for _, state in changes])
    ended = next((stamp for stamp, state in changes if state is end), recording.end)

    poses = {
        topic: _table(recording, topic, lambda m: np.concatenate(pose_arrays(m, BASE_FRAME)), 7) for topic in _POSES
    }
    keypoints = _table(recording, "keypoints", lambda m: keypoints_array(m).ravel(), 24)
    first = next((stamp for stamp in keypoints[0] if stamp >= began), None)
    if first is None or first >= ended:
        raise BagError(f"{where}: expected keypoints of an episode, there are none between its start and its end")
    times = np.arange(first, ended, _SECOND // RATE)
    after = np.append(times[1:], ended)

    def newest(what: str, stamps: np.ndarray, values: np.ndarray, before: np.ndarray) -> np.ndarray:
        rows = np.searchsorted(stamps, before, side="right") - 1
        if (rows < 0).any():
            raise BagError(f"{where}: expected {what} from the episode's start on, there is none")
        return values[rows]

    columns = {
        STATE: newest("joint_states", states, state.reshape(len(states), -1), times),
        KEYPOINTS: newest("keypoints", *keypoints, times + _ROUNDING),
        GOAL: newest("goal_pose", *poses["goal_pose"], times),
        ACTION: newest("effort_command", orders, order[:, 0], after - 1),
        TORQUE: newest("effort_command", orders, order[:, 2], after - 1),
        TARGET: _targets(
            *poses["target_pose"], _table(recording, "target_gains", lambda m: gains_array(m).ravel(), 14), times
        ),
        PHASE: np.array([[ACTIVE.index(phase)] for phase in _phases(changes, times)]),
        DONE: (np.arange(len(times)) == len(times) - 1)[:, None],
    }
    domain = read_recorded_task(recording)
    success = end is not None and end.phase == SUCCEEDED
    if len(poses["object_pose"][0]):
        columns[OBJECT] = newest("object_pose", *poses["object_pose"], times + _ROUNDING)
        place = newest("object_pose", *poses["object_pose"], np.array([ended + _ROUNDING]))[0]
        goal = columns[GOAL][-1]
        success = score_outcome(domain, [], Pose(place[:3], place[3:]), Pose(goal[:3], goal[3:]), 0.0).success
    columns[SUCCESS] = columns[DONE] & success
    return EpisodeFrames(domain, success, columns, _images(recording, times))


def _table(recording: Recording, topic: str, read: Callable, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) ns and values (n, width) of the messages of a topic."""
    rows = [*recording.read(topic, read)]
    values = np.array([value for _, value in rows], float).reshape(len(rows), width)
    return np.array([stamp for stamp, _ in rows], np.int64), values


def _phases(changes, times: np.ndarray) -> list[str]:
    rows = np.searchsorted([stamp for stamp, _ in changes], times, side="right") - 1
    return [changes[row][1].phase for row in rows]


def _targets(stamps: np.ndarray, poses: np.ndarray, gains, times: np.ndarray) -> np.ndarray:
    """The policy's output (n, 21) for the frames: gains have no stamp, and are the first published after the image was taken."""
    answers = np.zeros((len(times), poses.shape[1] + gains[1].shape[1]))
    for row, time in enumerate(times):
        mine = np.flatnonzero(np.abs(stamps - time) <= _ROUNDING)
        newest = np.searchsorted(gains[0], time - _ROUNDING)
        if mine.size and newest < len(gains[0]):
            answers[row] = np.concatenate([poses[mine[0]], gains[1][newest]])
    return answers


def _images(recording: Recording, times: np.ndarray) -> np.ndarray:
    """The newest image of each frame."""
    pictures: list[np.ndarray] = []
    last = None
    for stamp, pixels in recording.read("camera/image_raw", image_array):
        while len(pictures) < len(times) and stamp > times[len(pictures)] + _ROUNDING:
            if last is None:
                raise BagError(f"bag {recording.path}: expected an image from the episode's start on, there is none")
            pictures.append(last)
        if len(pictures) == len(times):
            break
        last = pixels
    if last is not None:
        pictures += [last] * (len(times) - len(pictures))
    return np.array(pictures, np.uint8)

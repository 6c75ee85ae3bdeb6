"""One recorded episode as arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from np_description.camera import CAMERA
from np_description.contact.depths import PAIRS
from np_description.contact.penetration import Penetration
from np_description.domains import Pose, Task, pose_error
from np_description.keypoints import box_keypoints
from np_description.message_arrays import (
    image_array,
    keypoints_array,
    pose_arrays,
    wrench_array,
)
from np_description.objects.choice import read_domain
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_description.phases import PRE, PhaseState
from np_record.bag import BagError, Recording
from np_record.bag_writer import INCOMPLETE
from np_record.bulk import read_joint_states
from np_record.outcome import Outcome, score_outcome
from np_record.recorded_phases import PHASE_TOPICS, read_phase_changes

SECOND = 1e9


@dataclass(frozen=True)
class Series:
    """Samples over time."""

    time: np.ndarray
    """(n,) s from the start of the bag."""
    values: np.ndarray
    """(n, ...)."""

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class EpisodeData:
    """Everything that a report shows."""

    domain: Task
    """Its task."""
    information: dict
    """The recorder's run_info."""
    position: Series
    """Joints (n, 7) rad, measured."""
    velocity: Series
    """(n, 7) rad/s, measured."""
    effort: Series
    """(n, 7) Nm, measured."""
    wrench: Series
    """(n, 6) N, Nm, filtered external wrench on the hand; n = 0 where it was not recorded."""
    command: Series
    """(n, 7) Nm, commanded torque."""
    target: Series
    """(n, 7) rad, joint targets."""
    object_position: Series
    """(n, 3) m."""
    object_quaternion: Series
    """(n, 4) wxyz."""
    keypoints: Series
    """(n, 8, 3) u px, v px, score."""
    keypoint_error: Series
    """(n, 8) px to the projected truth of the same stamp."""
    distance: Series
    """(n,) m, object to goal."""
    angle: Series
    """(n,) rad, likewise."""
    goal: Pose
    """Of the object."""
    depths: Mapping[str, Series]
    """By pair of shapes: penetration depth (n,) m, 0 without contact."""
    phases: list[tuple[float, PhaseState]]
    """(s, phase), when each phase began."""
    counts: dict[str, int]
    """Messages by topic."""
    duration: float
    """s."""
    outcome: Outcome
    """How it ended."""


def load_episode(recording: Recording) -> EpisodeData:
    """The first episode of a recording. Raises BagError where what a report needs is missing."""
    start, where = recording.start, f"bag {recording.path}"
    for name in ("joint_states", "object_pose", "goal_pose"):
        if not recording.counts.get(name):
            raise BagError(f"{where}: expected messages on {name} for a report, it has none")
    joints = recording.rows("joint_states", "effort_command")

    def seconds(stamps) -> np.ndarray:
        return (np.asarray(stamps, np.int64) - start) / SECOND

    def joint_series(name: str, names: Sequence[str]) -> Series:
        stamps, values = read_joint_states(where, joints.get(name), names)
        return Series(seconds(stamps), values)

    def series(name: str, read: Callable, shape: tuple[int, ...]) -> Series:
        rows = [*recording.read(name, read)]
        return Series(seconds([at for at, _ in rows]), np.array([v for _, v in rows], float).reshape(len(rows), *shape))

    states, commands = joint_series("joint_states", STATE_NAMES), joint_series("effort_command", JOINT_NAMES)
    poses = series("object_pose", lambda m: np.concatenate(pose_arrays(m, BASE_FRAME)), (7,))
    wrench = series("external_wrench", lambda m: wrench_array(m, BASE_FRAME), (6,))
    keypoints = series("keypoints", keypoints_array, (8, 3))
    domain = read_recorded_task(recording)
    goal = Pose(*next(recording.read("goal_pose", lambda m: pose_arrays(m, BASE_FRAME)))[1])
    distance, angle = pose_error(poses.values[:, :3], poses.values[:, 3:], goal.position, goal.quaternion)
    changes = read_phase_changes(where, recording.rows(*PHASE_TOPICS))
    phases = [((stamp - start) / SECOND, state) for stamp, state in changes]
    published = [state for _, state in phases]
    began = next((number for number, state in enumerate(published) if state.phase == PRE), 0)
    duration = (recording.end - start) / SECOND
    final = Pose(poses.values[-1, :3], poses.values[-1, 3:])
    return EpisodeData(
        domain=domain,
        information=recording.information,
        position=Series(states.time, states.values[:, 0, :7]),
        velocity=Series(states.time, states.values[:, 1, :7]),
        effort=Series(states.time, states.values[:, 2, :7]),
        wrench=wrench,
        target=Series(commands.time, commands.values[:, 0]),
        command=Series(commands.time, commands.values[:, 2]),
        object_position=Series(poses.time, poses.values[:, :3]),
        object_quaternion=Series(poses.time, poses.values[:, 3:]),
        keypoints=keypoints,
        keypoint_error=_keypoint_error(keypoints, poses, domain),
        distance=Series(poses.time, distance),
        angle=Series(poses.time, angle),
        goal=goal,
        depths=_depths(Series(states.time, states.values[:, 0]), poses, domain),
        phases=phases,
        counts=recording.counts,
        duration=duration,
        outcome=score_outcome(domain, published[began:], final, goal, duration, _early_end(recording)),
    )


def read_recorded_task(recording: Recording) -> Task:
    """The domain named in a recording's run_info. Raises BagError."""
    try:
        return read_domain(recording.information)
    except ValueError as error:
        text = str(error)
        raise BagError(text if text.startswith("bag ") else f"bag {recording.path}: run_info: {text}") from error


def _early_end(recording: Recording) -> str:
    """Why the recording ends before its episode, "" where its run_info gives no reason."""
    why = recording.information.get(INCOMPLETE)
    return f"the recording ends early: {why}" if why else ""


def read_images(recording: Recording):
    """(time s, pixels (height, width, 3) uint8) of the recorded images, one after the other."""
    for stamp, pixels in recording.read("camera/image_raw", image_array):
        yield (stamp - recording.start) / SECOND, pixels


def _depths(joints: Series, poses: Series, domain: Task) -> dict[str, Series]:
    """At every true pose that has a state of its stamp; pairs that never touch are left out."""
    common, i, j = np.intersect1d(joints.time, poses.time, return_indices=True)
    penetration = Penetration(domain)
    rows = [
        penetration.depths(q, Pose(pose[:3], pose[3:]))
        for q, pose in zip(joints.values[i], poses.values[j], strict=True)
    ]
    touching = [pair for pair in PAIRS if any(pair in row for row in rows)]
    return {pair: Series(common, np.array([row.get(pair, 0.0) for row in rows])) for pair in touching}


def _keypoint_error(keypoints: Series, poses: Series, domain: Task) -> Series:
    common, i, j = np.intersect1d(keypoints.time, poses.time, return_indices=True)
    corners = box_keypoints(np.asarray(domain.half_size), poses.values[j, :3], poses.values[j, 3:])
    truth = CAMERA.project(corners)[0]
    return Series(common, np.linalg.norm(keypoints.values[i, :, :2] - truth, axis=-1))

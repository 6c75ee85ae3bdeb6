"""A baseline of the chain's set: a learned residual. What the believed simulator gets wrong from image to image, as a ridge regression.

State: where the tip is to the object, and how fast it goes; the object's step to this image and to the next, as the believed simulator has them, all
as seen along the stroke; which way that goes; and products of these two by two. What is learned is by how much the next place and heading of the object, where the picture has it, are off the believed
step (Golemo et al., CoRL 2018, with a regression in place of a network: a recording has some 3,000 steps). It is learned of the motion in the
recording that the doctor hears, and names nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sim2real.effects.patch import Patch
from sim2real.recordings.reading import ContractViolation
from sim2real.task.object_motion.simulated import LEAST_CORNERS, MOTION, Simulated
from sim2real.task.object_motion.windows import Window, windows
from sim2real.task.suite.recording import TaskRecording

from np_blind.chain.others import Told
from np_common.rotations import matrix_from_quaternion, quaternion_multiply, yaw_quaternion
from np_control.kinematics import forward_kinematics
from np_description.camera import CAMERA
from np_description.domains import Pose
from np_description.keypoints import box_keypoints

PENALTIES = (1e1, 1e2, 1e3, 1e4, 1e5)
ORDERS = 1, 2  # of products: none, or two by two
FOLDS = 5
ROUNDS = 5  # of the fit of a place to an image
DOUBT = 1.5  # px, from which on a corner counts less
SMOOTHED = 3  # images, of which the median is what is learned
SIZE = 0.05  # m, half the object's width: what a rad of heading counts as
_PAIRS = np.triu_indices(14)  # of the state
_STEPS = np.array([1e-4, 1e-4, 1e-3])  # of the derivatives: m, m, rad


@dataclass(frozen=True, eq=False)
class Course:
    """A window of n images. poses: of the object in the believed simulator; plane (n, 3): their x, y m, and rad by which they are turned since the
    first; tip, tip_speed (n, 3): of the fingertip m, m/s; way: rad, direction in which the stroke goes; away (n, 3): x, y m and rad by which the picture has the object elsewhere, NaN where it has it nowhere."""

    window: Window
    simulated: Simulated
    poses: list[Pose]
    plane: np.ndarray
    tip: np.ndarray
    tip_speed: np.ndarray
    way: float
    away: np.ndarray


@dataclass(frozen=True, eq=False)
class Residual:
    """scale (z,): of the state; weights (f, 3): of its numbers and, with an order of 2, their products, metres and rad an image. penalty: of the ridge
    regression."""

    order: int
    penalty: float
    scale: np.ndarray
    weights: np.ndarray

    def led(self, course: Course) -> np.ndarray:
        """x, y m and rad (n, 3) by which the object is elsewhere than the believed simulator has it, from where it rests."""
        away = np.zeros_like(course.plane)
        for n in range(len(away) - 1):
            step = features(state(course, n, away[n]), self.scale, self.order) @ self.weights
            away[n + 1] = away[n] + _turned(step, course.way)
        return away


def ask(recording: TaskRecording, seed: int) -> Told:
    """What is learned of a recording."""
    learned = learn(list(courses([recording])))

    def off(fresh: Sequence[TaskRecording]) -> np.ndarray:
        rows = [[_off(one, learned) for one in simulated] for simulated in _by_roughness(fresh)]
        return np.mean(rows, axis=0)

    return Told(
        None, {"order": learned.order, "penalty": learned.penalty, "corrects": float(learned.weights.any())}, off
    )


def learn(known: Sequence[Course]) -> Residual:
    """The residual, with the order and the penalty that leave least on windows that are not learned of; no correction where none helps."""
    names = sorted({_name(one) for one in known})
    left = np.zeros(len(ORDERS) * len(PENALTIES))
    nothing = sum(_left(one, np.zeros_like(one.plane)) for one in known)
    for fold in range(FOLDS):
        out = set(names[fold::FOLDS])
        inside, outside = ([one for one in known if (_name(one) in out) == is_out] for is_out in (False, True))
        for k, residual in enumerate(_fitted(inside)):
            left[k] += sum(_left(one, residual.led(one)) for one in outside)
    chosen = _fitted(known)[int(np.argmin(left))]
    if left.min() < nothing:
        return chosen
    return replace(chosen, weights=np.zeros_like(chosen.weights))


def state(course: Course, n: int, away: np.ndarray) -> np.ndarray:
    """(14,) of an image and of where the object is to the believed simulator: the tip's place to it and speed, the believed steps to this image and to
    the next, along and across the stroke; and the stroke's direction, for a camera stands on one side."""
    plane = course.plane
    before, after = plane[n] - plane[max(n - 1, 0)], plane[min(n + 1, len(plane) - 1)] - plane[n]
    tip = np.append(course.tip[n, :2] - plane[n, :2] - away[:2], course.tip[n, 2])
    along = [_turned(one, -course.way) for one in (tip, course.tip_speed[n], before, after)]
    return np.concatenate([*along, [np.cos(course.way), np.sin(course.way)]])


def features(state: np.ndarray, scale: np.ndarray, order: int) -> np.ndarray:
    """(f,) of a state (z,): its numbers, and with an order of 2 their products, as far as what was learned of went."""
    scaled = np.clip(state / scale, -3.0, 3.0)
    return scaled if order == 1 else np.concatenate([scaled, np.outer(scaled, scaled)[_PAIRS]])


def courses(recordings: Sequence[TaskRecording]) -> Iterator[Course]:
    """All windows of recordings of one object that can be predicted, over frictions as `motion.stage.errors` has them."""
    for simulated in _by_roughness(recordings):
        yield from (one for one in simulated if one is not None)


def _by_roughness(recordings: Sequence[TaskRecording]) -> Iterator[list[Course | None]]:
    asked = [window for one in recordings for window in windows(one)]
    for more in MOTION.rougher:
        simulated = Simulated(recordings[0].domain, Patch(), rougher=more)
        yield [_course(simulated, window) for window in asked]


def _course(simulated: Simulated, window: Window) -> Course | None:
    try:
        poses = simulated.predicted(window)
    except (ContractViolation, FloatingPointError):
        return None
    plane = np.array([[*pose.position[:2], _turn(poses[0], pose)] for pose in poses])
    log, track = window.recording.log, window.recording.track
    at = np.searchsorted(log.time, track.time[window.images] + window.recording.seen_from).clip(0, len(log.time) - 1)
    tip = forward_kinematics(log.position[at])[0]
    speed = np.gradient(tip, track.time[window.images], axis=0)
    reached = (tip - tip[0])[np.argmax(np.linalg.norm((tip - tip[0])[:, :2], axis=1))]
    way = float(np.arctan2(*reached[1::-1]))
    return Course(window, simulated, poses, plane, tip, speed, way, _smoothed(_away(window, poses)))


def _away(window: Window, poses: Sequence[Pose]) -> np.ndarray:
    """x, y m and rad (n, 3) by which images have the object elsewhere than poses, at their heights; NaN where too few corners are usable. Corners that
    are far off count less."""
    track, images = window.recording.track, window.images
    half = np.asarray(window.recording.domain.half_size)
    middle = np.array([pose.position for pose in poses])
    arms = np.array([box_keypoints(half, pose.position, pose.quaternion) for pose in poses]) - middle[:, None]
    usable, found = track.usable[images], np.zeros((len(poses), 3))
    seen = np.where(usable[..., None], track.pixels[images], 0.0)

    def shown(away: np.ndarray) -> np.ndarray:
        """px (n, 8, 2)."""
        c, s = np.cos(away[:, 2, None]), np.sin(away[:, 2, None])
        x, y, z = arms[..., 0], arms[..., 1], arms[..., 2]
        corners = np.stack([c * x - s * y, s * x + c * y, z], axis=-1) + middle[:, None]
        corners[..., :2] += away[:, None, :2]
        return CAMERA.project(corners.reshape(-1, 3))[0].reshape(len(away), 8, 2)

    for _ in range(ROUNDS):
        here = shown(found)
        left = seen - here
        slopes = np.stack([(shown(found + one) - here) / one.sum() for one in np.diag(_STEPS)], axis=-1)
        weight = usable * np.minimum(1.0, DOUBT / np.maximum(np.linalg.norm(left, axis=2), 1e-9)) ** 2
        square = np.einsum("nc,ncia,ncib->nab", weight, slopes, slopes)
        step = np.linalg.solve(square + 1e-9 * np.eye(3), np.einsum("nc,ncia,nci->na", weight, slopes, left)[..., None])
        found = found + step[..., 0]
    return np.where((usable.sum(axis=1) > LEAST_CORNERS)[:, None], found, np.nan)


def moved(pose: Pose, away: np.ndarray) -> Pose:
    """A pose that is elsewhere on the table by x, y m and rad (3,)."""
    place = pose.position + np.array([away[0], away[1], 0.0])
    return Pose(place, quaternion_multiply(yaw_quaternion(away[2]), pose.quaternion))


def _fitted(known: Sequence[Course]) -> list[Residual]:
    """The ridge regression with each order and penalty."""
    states, steps = [], []
    for one in known:
        for n in np.flatnonzero(np.isfinite(one.away).all(axis=1)[:-1] & np.isfinite(one.away).all(axis=1)[1:]):
            states.append(state(one, n, one.away[n]))
            steps.append(_turned(one.away[n + 1] - one.away[n], -one.way))
    scale, steps, found = np.sqrt(np.mean(np.square(states), axis=0)) + 1e-9, np.array(steps), []
    for order in ORDERS:
        rows = np.array([features(one, scale, order) for one in states])
        square, against = rows.T @ rows, rows.T @ steps
        for penalty in PENALTIES:
            weights = np.linalg.solve(square + penalty * np.eye(len(square)), against)
            found.append(Residual(order, penalty, scale, weights))
    return found


def _left(course: Course, away: np.ndarray) -> float:
    """m, root mean square over images by which the object is off where the picture has it."""
    off = (away - course.away) * [1.0, 1.0, SIZE]
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else 0.0


def _off(course: Course | None, learned: Residual) -> float:
    if course is None:
        return np.nan
    led = learned.led(course)
    try:
        return course.simulated.off(course.window, [moved(pose, one) for pose, one in zip(course.poses, led)])
    except ContractViolation:
        return np.nan


def _turned(vector: np.ndarray, by: float) -> np.ndarray:
    """(3,) whose first two numbers are turned by rad."""
    c, s = np.cos(by), np.sin(by)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def _turn(first: Pose, pose: Pose) -> float:
    """rad about the vertical."""
    rotation = matrix_from_quaternion(pose.quaternion) @ matrix_from_quaternion(first.quaternion).T
    return float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))


def _smoothed(away: np.ndarray) -> np.ndarray:
    """Medians over neighbours of (n, 3)."""
    padded = np.pad(away, ((SMOOTHED // 2, SMOOTHED // 2), (0, 0)), mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, SMOOTHED, axis=0), axis=-1)


def _name(course: Course) -> str:
    return course.window.experiment

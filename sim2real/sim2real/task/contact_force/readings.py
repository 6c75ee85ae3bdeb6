"""Forces of one experiment each, as single readings: of a stroke that drags, of a push, of a scrape.

A hand that pushes a face also holds it down or lifts it: by what its tip's friction takes, up to half the object's weight. So a push has
a normal force too. A tip that drags may slip over the object, or hop on it: only where the object is seen to follow, friction with the
table is what holds it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.excitation.contact_suite.contact_motions import SLOW, STROKE_SPEED
from sim2real.recordings.reading import ContractViolation
from sim2real.task.suite.object_pose import pose_at_start, pose_between
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.wrench import ArmMotion, arm_motion, leading_corner, tip_force_covariance, tip_forces
from sim2real.thresholds import THRESHOLDS

FORCE = THRESHOLDS.friction_and_mass
AIR = "drag_0"
"""The drag that presses nothing: the same way in the air."""
AROUND = 0.06, 0.2  # s before a stroke and after it, between which the object is seen to rest


@dataclass(frozen=True, eq=False)
class ForceReading:
    """The contact force of a stroke, a push or a scrape."""

    experiment: str
    """Experiment."""
    kind: str
    """drag, push or scrape."""
    force: float
    """Force N along the table against the motion (drag, push), or up the face (scrape)."""
    normal: float
    """Normal force N between the surfaces, besides the weight."""
    deviation: float
    """Standard deviation N of the force, from scatter and joint friction."""
    group: str = ""
    """Readings with the same error of the arm: strokes of drags, or pushes in one direction."""
    normal_deviation: float = 0.0
    """Standard deviation N of the normal force."""
    follows: float = 1.0
    """Share of the tip's path that the object follows in a drag."""
    way: tuple[float, float] = (0.0, 0.0)
    """Direction of a drag or push in the base frame."""
    place: tuple[float, float] = (0.0, 0.0)
    """Position m of the object, halfway."""


def read_forces(recording: TaskRecording, panda: PandaModel = NOMINAL, camera: Camera = CAMERA) -> list[ForceReading]:
    """Of all experiments of a recording; panda: the arm as it is; camera: over the table as it was felt, see `seen.over`."""
    found = list(_drags(recording, panda, camera))
    for name in recording.named("push"):
        found += _push(recording, name, panda, camera)
    for name in recording.named("scrape"):
        found += _scrape(recording, name, panda)
    return found


def _drags(recording: TaskRecording, panda: PandaModel, camera: Camera) -> Iterator[ForceReading]:
    """Each stroke of each drag; what the arm's model lacks on such a stroke was measured in the air."""
    names = recording.named("drag")
    if AIR not in names:
        return
    air = arm_motion(recording.log, recording.rows(AIR), panda)
    level = {heading: air.free(np.concatenate(strokes)) for heading, strokes in _strokes(air).items()}
    for name in names:
        moved = arm_motion(recording.log, recording.rows(name), panda)
        for heading, strokes in _strokes(moved).items():
            if name == AIR or heading not in level:
                continue
            axis, sign = heading
            on_hand = tip_forces(moved, level[heading], None, panda)
            for stroke in strokes:
                rows = stroke[FORCE.edge : -FORCE.edge]
                pressed = float(on_hand[rows, 2].mean()) if len(rows) else 0.0
                if len(rows) < FORCE.rows or pressed < FORCE.pressed or _chatters(moved, rows):
                    continue
                # An object that is led askew is held askew: what holds it is the whole of the force.
                along, across = -sign * on_hand[rows, axis], on_hand[rows, 1 - axis]
                force = float(np.hypot(along.mean(), across.mean()))
                follows, place = _measure_following(recording, moved, stroke, camera)
                error = _error(along)
                ahead = tuple(sign * float(n == axis) for n in range(2))
                yield ForceReading(name, "drag", force, pressed, error, "drags", FORCE.force, follows, ahead, place)


def _measure_following(
    recording: TaskRecording, moved: ArmMotion, stroke: np.ndarray, camera: Camera
) -> tuple[float, tuple[float, float]]:
    """Share of the tip's way in a stroke that the object is led along, and its place (2,) m halfway; 0 where it is not seen."""
    first, last = moved.time[stroke[0]], moved.time[stroke[-1]]
    try:
        begin = pose_between(recording, first - AROUND[1], first - AROUND[0], camera).position
        end = pose_between(recording, last + AROUND[0], last + AROUND[1], camera).position
    except ContractViolation:
        return 0.0, (0.0, 0.0)
    moments = np.array([first, last]) + np.array([-1, 1]) * np.mean(AROUND)
    tip = np.diff([np.interp(moments, moved.time, column) for column in moved.tip[:, :2].T])[:, 0]
    middle = (np.asarray(end) + begin)[:2] / 2
    return float((np.asarray(end) - begin)[:2] @ tip / (tip @ tip)), (float(middle[0]), float(middle[1]))


def _strokes(moved: ArmMotion) -> dict[tuple[int, int], list[np.ndarray]]:
    """Rows of the strokes at speed, by axis and sign of their direction."""
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    level = np.abs(moved.moves[:, 2]) < FORCE.lifts
    for axis in range(2):
        for sign in (1, -1):
            speed = sign * moved.moves[:, axis] / STROKE_SPEED
            rows = np.flatnonzero(level & (speed > FORCE.moving) & (speed < 2 - FORCE.moving))
            pieces = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            if strokes := [piece for piece in pieces if len(piece) >= FORCE.rows]:
                found[axis, sign] = strokes
    return found


def _push(recording: TaskRecording, name: str, panda: PandaModel, camera: Camera = CAMERA) -> list[ForceReading]:
    """The steady part of a push; what the arm's model lacks is measured on the run-up, at the same speed."""
    moved = arm_motion(recording.log, recording.rows(name), panda)
    run, ahead = _forward(moved)
    travelled = (moved.tip[run] - moved.tip[run[0]]) @ ahead
    free = run[travelled < SLOW.run_up / 2][FORCE.edge :]
    if len(free) < FORCE.rows or len(run) < 4 * FORCE.rows:
        return []
    points = leading_corner(ahead, moved.turn, moved.tip)
    directions = moved.turning(free)
    on_hand = tip_forces(moved, moved.free(free), points, panda, directions)
    along = -on_hand @ ahead
    usual = float(np.median(along[run[-len(run) // 3 :]]))
    on = run[int(np.argmax(along[run] > 0.5 * usual)) + 2 * FORCE.edge : -FORCE.edge]
    if len(on) < FORCE.rows or usual <= 0 or np.median(along[on]) < 0.5 * usual:
        return []
    try:
        centre = np.asarray(pose_at_start(recording, name, camera).position)
    except ContractViolation:
        return []
    aside = float(np.cross(ahead[:2], (points[on[0]] - centre)[:2]))
    # A push that turns the object takes a little less than one that does not, how much its support decides.
    turning = FORCE.turning * usual * (abs(aside) > FORCE.central)
    covariance = tip_force_covariance(moved, points, panda, directions)[on].mean(axis=0)
    # The tip's friction cannot hold the face by more than a share of what presses it: all that is known where joints rest.
    before, observed = (FORCE.face * usual) ** 2, covariance[2, 2]
    normal = before / (before + observed) * float(np.median(on_hand[on, 2]))
    deviation = np.sqrt(_error(along[on]) ** 2 + turning**2 + ahead @ covariance @ ahead)
    group = f"push {round(float(np.arctan2(ahead[1], ahead[0])) / (np.pi / 2)) % 4}"
    force, normal_deviation = float(np.median(along[on])), float(np.sqrt(before * observed / (before + observed)))
    direction = float(ahead[0]), float(ahead[1])
    halfway = centre[:2] + ahead[:2] * SLOW.travel / 2
    place = float(halfway[0]), float(halfway[1])
    return [
        ForceReading(name, "push", force, normal, float(deviation), group, normal_deviation, way=direction, place=place)
    ]


def _forward(moved: ArmMotion) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the way forward of a tip that comes down, goes ahead and back, the jolt of a contact among them; its direction (3,)."""
    low = moved.tip[:, 2] < moved.tip[:, 2].min() + 0.01
    begin = int(np.argmax(low))
    away = np.linalg.norm(moved.tip[:, :2] - moved.tip[begin, :2], axis=1) * low
    last = max(int(away.argmax()), begin + 1)
    speed = np.linalg.norm(moved.moves[begin:last, :2], axis=1) * (np.abs(moved.moves[begin:last, 2]) < FORCE.lifts)
    at_speed = begin + np.flatnonzero(speed > FORCE.moving * np.quantile(speed, 0.98))
    travelled = (moved.tip[last] - moved.tip[begin]) * (1.0, 1.0, 0.0)
    ahead = travelled / max(float(np.linalg.norm(travelled)), 1e-6)
    return np.arange(at_speed[0], at_speed[-1] + 1) if len(at_speed) else at_speed, ahead


def _scrape(recording: TaskRecording, name: str, panda: PandaModel) -> list[ForceReading]:
    """The part in which the tip slides down the face of an object that is held."""
    moved = arm_motion(recording.log, recording.rows(name), panda)
    run, ahead = _forward(moved)
    if len(run) < 2 * FORCE.rows:
        return []
    free = moved.free(run[FORCE.edge : len(run) // 4])
    on_hand = tip_forces(moved, free, leading_corner(ahead, moved.turn, moved.tip), panda)
    held, upward = -on_hand @ ahead, on_hand[:, 2]
    clear = moved.tip[:, 2] > moved.tip[:, 2].min() + FORCE.clear
    down = moved.moves[:, 2] < -FORCE.slides
    rows = np.flatnonzero((np.arange(len(moved)) > run[-1]) & down & (held > FORCE.held) & clear)
    rows = max(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1), key=len)
    if len(rows) < FORCE.rows:
        return []
    return [ForceReading(name, "scrape", float(upward[rows].mean()), float(held[rows].mean()), _error(upward[rows]))]


def _chatters(moved: ArmMotion, rows: np.ndarray) -> bool:
    return float(np.abs(moved.moves[rows, 2]).mean()) > FORCE.chatter


def _error(values: np.ndarray) -> float:
    """Standard error of the mean of rows of which one in `FORCE.memory` is independent, and what every such force is off by."""
    scatter = np.std(values) / np.sqrt(max(len(values) / FORCE.memory, 1.0))
    return float(np.sqrt(scatter**2 + FORCE.force**2 + (FORCE.relative * values.mean()) ** 2))

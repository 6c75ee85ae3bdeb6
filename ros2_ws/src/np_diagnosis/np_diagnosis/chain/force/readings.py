"""Forces of one experiment each, as single readings: of a stroke that drags, of a push, of a scrape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from np_description.panda import NOMINAL, PandaModel
from np_diagnosis.chain.contact_force import Motion, forces, motion, side
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.chain.task.seen import seen_pose
from np_diagnosis.experiments.task.contacts import STROKE_SPEED
from np_diagnosis.recordings.reading import ContractViolation
from np_diagnosis.thresholds import THRESHOLDS

FORCE = THRESHOLDS.forcing
AIR = "drag_0"
"""The drag that presses nothing: the same way in the air."""


@dataclass(frozen=True, eq=False)
class Reading:
    """kind: drag, push or scrape. force N: along the table against the tip's motion (drag, push), or up the face (scrape). normal N: what
    presses the surfaces together besides weight. aside m: of a push, from the object's centre. deviation N of `force`, by its scatter."""

    experiment: str
    kind: str
    force: float
    normal: float
    aside: float
    deviation: float


def readings(recording: TaskRecording, panda: PandaModel = NOMINAL) -> list[Reading]:
    """Of all experiments of a recording; panda: the arm as it is."""
    found = list(_drags(recording, panda))
    for name in recording.named("push"):
        found += _push(recording, name, panda)
    for name in recording.named("scrape"):
        found += _scrape(recording, name, panda)
    return found


def _drags(recording: TaskRecording, panda: PandaModel) -> Iterator[Reading]:
    """Each stroke of each drag; what the arm's model lacks on such a stroke was measured in the air."""
    names = recording.named("drag")
    if AIR not in names:
        return
    air = motion(recording.log, recording.rows(AIR), panda)
    level = {heading: air.free(np.concatenate(strokes)) for heading, strokes in _strokes(air).items()}
    for name in names:
        moved = motion(recording.log, recording.rows(name), panda)
        for heading, strokes in _strokes(moved).items():
            if name == AIR or heading not in level:
                continue
            axis, sign = heading
            on_hand = forces(moved, level[heading], None, panda)
            for rows in strokes:
                # Where the tip chatters the object stops and goes, and friction is less than it is in sliding.
                rows = rows[FORCE.edge : -FORCE.edge]
                pressed = float(on_hand[rows, 2].mean()) if len(rows) else 0.0
                if len(rows) < FORCE.rows or pressed < FORCE.pressed or _chatters(moved, rows):
                    continue
                along = -sign * on_hand[rows, axis]
                yield Reading(name, "drag", float(along.mean()), pressed, 0.0, _error(along))


def _strokes(moved: Motion) -> dict[tuple[int, int], list[np.ndarray]]:
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


def _push(recording: TaskRecording, name: str, panda: PandaModel) -> list[Reading]:
    """The steady part of a push; what the arm's model lacks is measured on the run-up, at the same speed."""
    moved = motion(recording.log, recording.rows(name), panda)
    speed = np.linalg.norm(moved.moves[:, :2], axis=1) * (np.abs(moved.moves[:, 2]) < FORCE.lifts)
    first = _longest(speed > FORCE.moving * np.quantile(speed[: _last_forward(moved)], 0.98))
    if len(first) < 4 * FORCE.rows:
        return []
    way = moved.moves[first, :2].mean(axis=0)
    ahead = np.append(way / np.linalg.norm(way), 0.0)
    free = first[FORCE.edge : len(first) // 5]
    touched = forces(moved, moved.free(free), side(ahead, moved.turn, moved.tip), panda)
    along = -touched @ ahead
    usual = float(np.median(along[first[-len(first) // 3 :]]))
    on = first[int(np.argmax(along[first] > 0.5 * usual)) + 2 * FORCE.edge : -FORCE.edge]
    if len(on) < FORCE.rows or usual <= 0 or np.median(along[on]) < 0.5 * usual:
        return []
    try:
        centre = np.asarray(seen_pose(recording, name).position)
    except ContractViolation:
        return []
    point = side(ahead, moved.turn, moved.tip)[on[0]]
    aside = float(np.cross(ahead[:2], (point - centre)[:2]))
    # A push that turns the object takes a little less than one that does not, how much its support decides.
    turning = FORCE.turning * usual * (abs(aside) > FORCE.central)
    return [Reading(name, "push", float(np.median(along[on])), 0.0, aside, float(np.hypot(_error(along[on]), turning)))]


def _last_forward(moved: Motion) -> int:
    """Row at which the tip has gone farthest from where it came down."""
    low = moved.tip[:, 2] < moved.tip[:, 2].min() + 0.01
    begin = moved.tip[np.argmax(low), :2]
    away = np.linalg.norm(moved.tip[:, :2] - begin, axis=1) * low
    return max(int(away.argmax()), 1)


def _scrape(recording: TaskRecording, name: str, panda: PandaModel) -> list[Reading]:
    """The part in which the tip slides down the face of an object that is held."""
    moved = motion(recording.log, recording.rows(name), panda)
    at = moved.moves
    level = np.linalg.norm(at[:, :2], axis=1) * (np.abs(at[:, 2]) < FORCE.lifts)
    run = _longest(level > FORCE.moving * np.quantile(level[: _last_forward(moved)], 0.98))
    if len(run) < 2 * FORCE.rows:
        return []
    way = at[run, :2].mean(axis=0)
    ahead = np.append(way / np.linalg.norm(way), 0.0)
    on_hand = forces(moved, moved.free(run[FORCE.edge : len(run) // 4]), side(ahead, moved.turn, moved.tip), panda)
    held, upward = -on_hand @ ahead, on_hand[:, 2]
    clear = moved.tip[:, 2] > moved.tip[:, 2].min() + FORCE.clear
    rows = np.flatnonzero((np.arange(len(moved)) > run[-1]) & (at[:, 2] < -FORCE.slides) & (held > FORCE.held) & clear)
    rows = _longest(np.isin(np.arange(len(moved)), rows)) if len(rows) else rows
    if len(rows) < FORCE.rows:
        return []
    normal = float(held[rows].mean())
    return [Reading(name, "scrape", float(upward[rows].mean()), normal, 0.0, _error(upward[rows]))]


def _longest(held: np.ndarray) -> np.ndarray:
    """Rows of the longest stretch in which something (n,) holds."""
    rows = np.flatnonzero(held)
    return max(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1), key=len)


def _chatters(moved: Motion, rows: np.ndarray) -> bool:
    return float(np.abs(moved.moves[rows, 2]).mean()) > FORCE.chatter


def _error(values: np.ndarray) -> float:
    """Standard error of the mean of rows of which one in `FORCE.memory` says something new, and what every such force is off by."""
    scatter = np.std(values) / np.sqrt(max(len(values) / FORCE.memory, 1.0))
    return float(np.sqrt(scatter**2 + FORCE.force**2 + (FORCE.relative * values.mean()) ** 2))

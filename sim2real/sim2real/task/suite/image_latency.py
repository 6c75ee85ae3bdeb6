"""By how much images are late: an object that is pushed goes with the tip, whose path the joints give.

Where it comes to rest gives where on the tip's path it touches. How far behind that it is seen while both move is the delay.
A scale of the picture that is off shows as another share of the way, and is fitted with it.

Rows of a picture may be read one after another, so that how late an object is seen depends on where in the picture it is. The delay is that of the
picture's middle row, in the middle of its exposure; how long the rows take is no gap, is between nothing and a frame, and is fitted with the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from np_description.camera import CAMERA, Camera
from sim2real.effects.sentences import ValueWithInterval
from sim2real.excitation.contact_suite.tip import RADIUS
from sim2real.task.hypotheses import NORMAL_95
from sim2real.task.suite.oscillating_push import apply_play, find_oscillating_pushes
from sim2real.task.suite.pushed_object import PushedObject, find_push_end, mean_image_row, track_displacement
from sim2real.task.suite.recording import TaskRecording
from sim2real.thresholds import THRESHOLDS

LATENCY = THRESHOLDS.image_latency


@dataclass(frozen=True, eq=False)
class ImageLatency:
    """By how much images are late."""

    verdict: str
    """no_gap, ambiguous (a late image looks like a camera clock that is behind) or undetermined."""
    late: ValueWithInterval | None
    """Latency s with its 95 % interval; None where the stage abstains."""
    each: tuple[float, ...]
    """Latency s of every push."""
    pushes: tuple[PushedObject, ...]
    """Pushes that the estimate rests on."""
    abstention_reason: str = ""
    """Why the stage abstains."""


def estimate_image_latency(recordings: Sequence[TaskRecording], camera: Camera = CAMERA) -> ImageLatency:
    """From the slow pushes and shoves of recordings of one set-up, and from oscillating pushes."""
    pushes: list[PushedObject] = []
    for recording in recordings:
        pushes += [one for name in recording.pushes() if (one := _track_push(recording, name, camera))]
        pushes += find_oscillating_pushes(recording, camera)
    return latency_from_pushes(tuple(pushes))


def latency_from_pushes(pushes: tuple[PushedObject, ...]) -> ImageLatency:
    """The weighted mean over pushes. Its error follows from theirs, or from their scatter where that is larger, and from what all have in
    common."""
    fits = [_fit_delay(one) for one in pushes]
    good = [
        (fit, one) for fit, one in zip(fits, pushes) if fit[2] < LATENCY.left and abs(fit[0]) < 0.99 * LATENCY.within
    ]
    each, used = tuple(late for (late, _, _), _ in good), tuple(one for _, one in good)
    if sum(one.counts for one in used) < LATENCY.least:
        return ImageLatency(
            "undetermined",
            None,
            each,
            used,
            f"{len(each)} pushes led the object as they should; {LATENCY.least} are needed",
        )
    deviations = np.array([np.hypot(fit[1], LATENCY.sways if one.periods else 0.0) for fit, one in good])
    rows = np.array([one.row for one in used])
    value, own = _middle(np.array(each), deviations, rows)
    deviation = float(np.hypot(own, LATENCY.common))
    late = ValueWithInterval(value, value - NORMAL_95 * deviation, value + NORMAL_95 * deviation)
    return ImageLatency(
        "ambiguous" if late.low > LATENCY.seen or late.high < -LATENCY.seen else "no_gap", late, each, used
    )


def _middle(late: np.ndarray, deviation: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Delay s of the picture's middle row, with its deviation, of delays (n,) of pushes with deviations (n,) that were seen in `rows` (n,), shares of
    the picture's height. One that is far off the others counts for as little as it should."""
    deviation, (usual, spread) = np.hypot(deviation, LATENCY.own), LATENCY.rows
    columns, off = np.column_stack([np.ones(len(rows)), -rows]), late + usual * rows  # lower rows are of later moments
    found, left = np.array([np.median(off), 0.0]), np.zeros(len(late))  # s, and s by which rows take longer than usual
    for _ in range(20):
        left = (off - columns @ found) / deviation
        weights = 1 / deviation**2 / np.maximum(1.0, np.abs(left) / LATENCY.far_off)
        precision = columns.T @ (weights[:, None] * columns) + np.diag([0.0, spread**-2])
        found = np.linalg.solve(precision, columns.T @ (weights * off))
    scatter = float(weights @ left**2 / weights.sum()) * len(late) / max(len(late) - 1, 1)
    return float(found[0]), float(np.sqrt(max(1.0, scatter) * np.linalg.inv(precision)[0, 0]))


def _fit_delay(one: PushedObject) -> tuple[float, float, float]:
    """s by which the images of a push or a sway are late, with its deviation, and m that is left of the object's way."""

    def off(x: np.ndarray) -> np.ndarray:
        """x: delay in ms, scale in %, place of rest in mm; of a sway its play in mm."""
        tip = apply_play(one.tip, 1e-3 * abs(x[3])) if one.periods else one.tip
        predicted = (1 + 1e-2 * x[1]) * np.interp(one.time - 1e-3 * x[0], one.at, tip) + 1e-3 * x[2]
        usual = [x[1] / LATENCY.scale, *(x[3:] / (1e3 * LATENCY.play))]  # or these would stand in for the delay
        return np.append((predicted - one.way) / LATENCY.way, usual)

    first, scale = ([0.1], [0.1]) if one.periods else ([], [])
    starts = [np.array([delay, 0.0, 0.0, *first]) for delay in np.arange(-100.0, 1e3 * LATENCY.within, 20.0)]
    start = min(starts, key=lambda x: float(off(x) @ off(x)))
    found = least_squares(off, start, loss="soft_l1", diff_step=1e-2, x_scale=(10.0, 1.0, 0.3, *scale))
    variance = np.linalg.inv(found.jac.T @ found.jac)[0, 0] * max(1.0, 2 * found.cost / len(one.time))
    return (
        1e-3 * float(found.x[0]),
        1e-3 * float(np.sqrt(variance)),
        LATENCY.way * float(np.sqrt(np.mean(off(found.x)[: len(one.time)] ** 2))),
    )


def _track_push(recording: TaskRecording, name: str, camera: Camera) -> PushedObject | None:
    """The images from when the object is on its way until both rest; None where it turns, does not go along or is not seen."""
    rest = find_push_end(recording, name, camera)
    if rest is None:
        return None
    taken, ahead = recording.track.time + recording.seen_from, rest.ahead
    images = np.flatnonzero((taken > rest.begin) & (taken < rest.leaves))
    moved_by, turned = track_displacement(recording, images, rest.pose, ahead, camera)
    # What goes with the tip is where it touches, which a turning object's middle does not.
    lever = rest.at + RADIUS * ahead - rest.pose.position
    aside = float(lever @ [-ahead[1], ahead[0], 0.0])
    path = moved_by - np.sin(turned) * aside + (np.cos(turned) - 1) * float(lever @ ahead)
    known = np.isfinite(path)
    # On its way: once it has gone a part of what it goes in all, so that the tip surely has it.
    moved = path - np.nanmin(path) if known.any() else path
    going = known & (moved > LATENCY.begun) & (np.arange(len(path)) > np.argmax(moved > LATENCY.begun))
    if going.sum() < LATENCY.images or np.nanmax(moved) < LATENCY.far or np.nanmax(np.abs(turned)) > LATENCY.turned:
        return None
    row = mean_image_row(recording, images[going], camera)
    return PushedObject(name, taken[images][going], path[going], rest.time, (rest.tip - rest.at) @ ahead, row)

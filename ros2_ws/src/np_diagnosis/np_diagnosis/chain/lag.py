"""Are images late? The object is led by the fingertips, whose joints say when it moves; its corners say when it is seen to move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from np_description.camera import CAMERA, Camera
from np_description.keypoints import box_keypoints
from np_diagnosis.chain.contact_force import motion
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.chain.task.seen import seen_pose
from np_diagnosis.experiments.task.contacts import CYCLES
from np_diagnosis.recordings.reading import ContractViolation
from np_diagnosis.thresholds import THRESHOLDS
from np_effects.saying import Value

LAG = THRESHOLDS.lagging
PRESSED = 0.003  # m over the lowest point of a sway, up to which the tip holds the object
STEP = 1e-4  # m, of the differences that say how far a corner moves in the picture


@dataclass(frozen=True, eq=False)
class Grip:
    """The object held by the tip: seen (n, 2) m, where it is seen to be from its mean place, at the stamps `time` (n,) s; tip (m, 2) m at
    the times `at` (m,) s."""

    time: np.ndarray
    seen: np.ndarray
    at: np.ndarray
    tip: np.ndarray

    def off(self, delay: float) -> float:
        """Sum of squares (m^2) by which the object is elsewhere than the tip was a `delay` s before, but for a share that it slips."""
        led = np.column_stack([np.interp(self.time - delay, self.at, column) for column in self.tip.T])
        led = led - led.mean(axis=0)
        share = float((led * self.seen).sum() / max((led**2).sum(), 1e-12))
        return float(((self.seen - share * led) ** 2).sum())


@dataclass(frozen=True, eq=False)
class Lag:
    """delay s by which images are later than their stamps, None where the recording does not tell, for the reason in `doubt`. verdict: no_gap,
    ambiguous (camera_latency or clock_offset: no recording of one stream tells), identified (images of what is still to come: the clock),
    undetermined. images: of an object that is led. before, after: m by which it is seen elsewhere than led, in parts that were not fitted."""

    verdict: str
    images: int
    delay: Value | None = None
    effects: tuple[str, ...] = ()
    doubt: str = ""
    before: float | None = None
    after: float | None = None


def lag(recording: TaskRecording, camera: Camera = CAMERA) -> Lag:
    """Of the sways of a recording. camera: the one that is believed in."""
    grips = [grip for name in recording.named("sway") for grip in _grips(recording, name, camera)]
    images = sum(len(grip.time) for grip in grips)
    if images < LAG.images or len(grips) < 3:
        return Lag("undetermined", images, doubt=f"the object was led to and fro in {images} images")
    every, parts = _best(grips), [_best(grips[:n] + grips[n + 1 :]) for n in range(len(grips))]
    count = len(parts)
    # Jackknife: each grip left out once.
    pseudo = count * every - (count - 1) * np.array(parts)
    half = float(student.ppf(0.975, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    delay = Value(every, every - half, every + half)
    before, after = (
        float(np.sqrt(sum(g.off(d) for g, d in zip(grips, delays)) / images)) for delays in (np.zeros(count), parts)
    )
    if delay.low <= 0 <= delay.high or abs(every) < LAG.matters:
        verdict, effects = "no_gap", ()
    elif every > 0:
        verdict, effects = "ambiguous", ("camera_latency", "clock_offset")
    else:
        verdict, effects = "identified", ("clock_offset",)
    return Lag(verdict, images, delay, effects, "", before, after)


def _best(grips: Sequence[Grip]) -> float:
    def cost(delay: float) -> float:
        return sum(grip.off(delay) for grip in grips)

    coarse = np.arange(-LAG.widest, LAG.widest + 1e-9, 0.01)
    near = float(coarse[int(np.argmin([cost(d) for d in coarse]))])
    return float(minimize_scalar(cost, bounds=(near - 0.01, near + 0.01), method="bounded", options={"xatol": 1e-6}).x)


def _grips(recording: TaskRecording, name: str, camera: Camera) -> list[Grip]:
    """A sway in as many parts as it has cycles, each of which counts as one measurement."""
    moved = motion(recording.log, recording.rows(name))
    down = np.flatnonzero(moved.tip[:, 2] < moved.tip[:, 2].min() + PRESSED)
    speed = np.linalg.norm(moved.moves[:, :2], axis=1)
    led = down[speed[down] > 0.3 * speed[down].max()]
    try:
        pose = seen_pose(recording, name, camera)
    except ContractViolation:
        return []
    corners = box_keypoints(recording.domain.half_size, pose.position, pose.quaternion)
    here, steps = camera.project(corners)[0], STEP * np.eye(3)[:2]
    slopes = np.stack([(camera.project(corners + step)[0] - here) / STEP for step in steps], axis=-1)
    time, track = recording.track.time + recording.seen_from, recording.track
    images = np.flatnonzero((time > moved.time[led[0]]) & (time < moved.time[led[-1]]))
    usable = track.usable[images].all(axis=0)
    if len(images) < LAG.images or usable.sum() < 3:
        return []
    found = []
    for part in np.array_split(images, CYCLES):
        away = track.pixels[part][:, usable] - track.pixels[part][:, usable].mean(axis=0)
        seen = np.linalg.lstsq(slopes[usable].reshape(-1, 2), away.reshape(len(part), -1).T, rcond=None)[0].T
        found.append(Grip(time[part], seen, moved.time, moved.tip[:, :2]))
    return found

"""Two streams of poses of one arm with clocks that differ: its hand's by forward kinematics, and that of a camera on it.

Separate from the doctor's estimator: poses come from joints that move, pictures are exposed for a while, stamps jitter,
noise is correlated from picture to picture, pictures are lost, and where the camera sits nobody has told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from sim2real.task.streams import Stream, from_arrays

from np_control.kinematics import hand_pose
from np_description.panda import NOMINAL

WAVES = 4  # sinusoids a joint
BEND = 0.4  # m
EXPOSED = 5  # moments of an exposure that are averaged


@dataclass(frozen=True)
class Rig:
    """What is recorded, and how badly. duration s; rates Hz; frequencies Hz of the sinusoids of each joint, and the share of
    half its range that they cover together; exposure s, about the moment that counts; jitter s, standard deviation of a
    picture's stamp; angle rad and place m: standard deviations of a picture's pose, correlated by `memory` from one to the
    next; bend rad: error of a pose that depends on the pose alone, as of a lens, a wave of BEND in place; lost: share of pictures; offset s at the middle, drift ppm: of the camera's stamps."""

    duration: float = 40.0
    arm_rate: float = 100.0
    camera_rate: float = 30.0
    frequencies: tuple[float, float] = (0.05, 0.8)
    reach: float = 0.35
    exposure: float = 0.012
    jitter: float = 0.003
    encoder: float = 5e-5
    angle: float = 0.006
    place: float = 0.001
    memory: float = 0.6
    bend: float = 0.0
    lost: float = 0.1
    offset: float = 0.03
    drift: float = 0.0


@dataclass(frozen=True, eq=False)
class Motion:
    """Joints (7,) as sums of sinusoids."""

    middle: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def joints(self, time: np.ndarray) -> np.ndarray:
        """Joint angles (n, 7) rad at times (n,) s."""
        angle = 2 * np.pi * self.frequency * time[:, None, None] + self.phase
        return self.middle + (self.amplitude * np.sin(angle)).sum(axis=2)


def random_motion(rig: Rig, rng: np.random.Generator) -> Motion:
    """A smooth motion within the joints' range."""
    lower, upper = NOMINAL.position_lower, NOMINAL.position_upper
    share = rng.dirichlet(np.ones(WAVES), size=7)
    return Motion(
        (lower + upper) / 2,
        share * (rig.reach * (upper - lower) / 2)[:, None],
        rng.uniform(*rig.frequencies, size=(7, WAVES)),
        rng.uniform(0, 2 * np.pi, size=(7, WAVES)),
    )


def record(rig: Rig, rng: np.random.Generator, motion: Motion | None = None) -> tuple[Stream, Stream]:
    """(the hand in the base, the camera in its target's frame or the target in the camera's), both as they were stamped."""
    motion = motion or random_motion(rig, rng)
    time = np.arange(0.0, rig.duration, 1 / rig.arm_rate)
    read = motion.joints(time) + rig.encoder * rng.normal(size=(time.size, 7))
    place, turn = hand_pose(read)
    hand = from_arrays("hand", time, place, Rotation.from_matrix(turn).as_quat())
    return hand, _pictures(rig, rng, motion)


def _pictures(rig: Rig, rng: np.random.Generator, motion: Motion) -> Stream:
    exposed = np.arange(rng.uniform(0, 1 / rig.camera_rate), rig.duration, 1 / rig.camera_rate)
    moments = exposed[:, None] + rig.exposure * (np.arange(EXPOSED) / (EXPOSED - 1) - 0.5)
    place, turn = hand_pose(motion.joints(moments.ravel()))
    mount, target = Rotation.random(rng=rng), Rotation.random(rng=rng)
    arm_length, origin = rng.normal(scale=0.1, size=3), rng.normal(scale=0.5, size=3)
    turn = Rotation.from_matrix(turn)
    place = target.apply(place + turn.apply(arm_length)) + origin
    seen = target * turn * mount
    # What is seen is the mean of the exposure.
    half = seen[EXPOSED // 2 :: EXPOSED]
    spread = (half.inv()[np.repeat(np.arange(exposed.size), EXPOSED)] * seen).as_rotvec()
    seen = half * Rotation.from_rotvec(spread.reshape(-1, EXPOSED, 3).mean(axis=1))
    place = place.reshape(-1, EXPOSED, 3).mean(axis=1)
    wave = np.sin(2 * np.pi * place @ rng.normal(size=(3, 3)) / BEND + rng.uniform(0, 2 * np.pi, 3))
    seen = seen * Rotation.from_rotvec(rig.bend * wave)
    seen = seen * Rotation.from_rotvec(rig.angle * _correlated(rng, exposed.size, rig.memory))
    place = place + rig.place * _correlated(rng, exposed.size, rig.memory)
    if rng.random() < 0.5:  # trackers give the target in the camera's frame, or the other way round
        seen = seen.inv()
        place = -seen.apply(place)
    stamp = exposed + rig.offset + 1e-6 * rig.drift * (exposed - rig.duration / 2)
    stamp = stamp + rig.jitter * rng.normal(size=stamp.size)
    kept = rng.random(stamp.size) >= rig.lost
    return from_arrays("camera", stamp[kept], place[kept], seen.as_quat()[kept])


def _correlated(rng: np.random.Generator, rows: int, memory: float) -> np.ndarray:
    """Noise (n, 3) of standard deviation 1, each row remembering the one before by `memory`."""
    white = rng.normal(size=(rows + 100, 3)) * np.sqrt(1 - memory**2)
    from scipy.signal import lfilter  # takes a second, of which no --help has need

    return lfilter([1.0], [1.0, -memory], white, axis=0)[100:]

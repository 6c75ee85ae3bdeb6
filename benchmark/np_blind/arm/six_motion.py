"""How the arm of six hinges moves and is recorded: as its own controller would, sums of sinusoids and slow triangles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from np_blind.arm.loop import Sensors
from np_blind.arm.plant.blind_arm import PERIOD, BatchedArms
from np_blind.arm.plant.physics import Physics
from np_blind.arm.sampling.six_hinges import READY, TORQUE_NOISE, chain

RUNAWAY = 20.0  # rad/s
FILE = "recording.npz"
STIFFNESS = np.array([2000.0, 2000.0, 1500.0, 400.0, 400.0, 300.0])  # Nm/rad
DAMPING = np.array([140.0, 140.0, 90.0, 14.0, 14.0, 10.0])  # Nms/rad
SECOND = np.array([-0.6, -2.2, 0.9, -0.6, 1.2, -0.8])  # here gravity has other levers, and turns its sign in the wrist
BLEND = 1.5  # s, in which a motion begins and ends
CORNER = 0.1  # s, of a triangle
FIRST = 100  # row from which on torque is of whole periods, and all is at rest
_SEED = 20261123


@cache
def targets() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position rad, speed rad/s, acceleration rad/s^2 (n, 6) of the target, a row a period; it rests at both ends."""
    rng = np.random.default_rng(_SEED)
    first = _waves(rng, 30.0, READY, 0.22)
    slow = [_triangle(2, READY, 8.0, 0.02), _triangle(3, READY, 4.0, 0.1), _triangle(6, READY, 2.0, 0.4)]
    second = _waves(rng, 25.0, SECOND, 0.2)
    parts = [_rest(READY, 0.6), first, *slow, _move(READY, SECOND, 4.0), second, _rest(SECOND, 0.6)]
    position = np.concatenate(parts)
    speed = np.gradient(position, PERIOD, axis=0)
    return position, speed, np.gradient(speed, PERIOD, axis=0)


def record(physics: Physics, seeds: Sequence[Sequence[int]], paths: Sequence[Path]) -> dict[int, float]:
    """Move the arms, and write the recording of each to its path, a new folder's `FILE`; s after which each other one ran away.

    seeds: of each arm's noise and chances.
    """
    position, speed, acceleration = targets()
    streams, chances = ([np.random.default_rng([*seed, k]) for seed in seeds] for k in (1, 2))
    plant = BatchedArms(physics, READY, chances, chain())
    sensors = Sensors(physics, streams, TORQUE_NOISE)
    shown = np.empty((3, len(position), len(physics), len(READY)))
    lost: dict[int, float] = {}
    for row in range(len(position)):
        held = plant.held if row else np.zeros_like(plant.q)
        q, dq, effort, _, _ = sensors.read(plant)
        shown[:, row] = q, dq, effort + held
        fast = ~(np.abs(plant.dq) < RUNAWAY).all(axis=1)
        lost |= {arm: row * PERIOD for arm in np.flatnonzero(fast).tolist() if arm not in lost}
        matrix, coriolis = plant.begin(np.where(fast[:, None], READY, q), np.where(fast[:, None], 0.0, dq))
        torque = STIFFNESS * (position[row] - q) + DAMPING * (speed[row] - dq) + coriolis + matrix @ acceleration[row]
        plant.step(np.where(fast[:, None], 0.0, torque))
        plant.q[fast], plant.dq[fast] = READY, 0.0  # it stands, so that the others go on
    time = PERIOD * np.arange(len(position))
    for arm, path in enumerate(paths):
        if arm not in lost:
            path.mkdir(parents=True)
            names = ("q_rad", "dq_rad_s", "tau_J_Nm")
            rows = {name: values[FIRST:, arm] for name, values in zip(names, shown)}
            np.savez(path / FILE, t_s=time[FIRST:], **rows)
    return lost


def _times(duration: float) -> np.ndarray:
    return PERIOD * np.arange(round(duration / PERIOD))


def _rest(posture: np.ndarray, duration: float) -> np.ndarray:
    return np.tile(posture, (len(_times(duration)), 1))


def _window(time: np.ndarray, duration: float) -> np.ndarray:
    """From 0 to 1 and back, smoothly."""
    share = np.clip(np.minimum(time, duration - time) / BLEND, 0.0, 1.0)
    return (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]


def _waves(rng: np.random.Generator, duration: float, posture: np.ndarray, amplitude: float) -> np.ndarray:
    """Each joint at three frequencies of its own, .1 to 1.3 Hz."""
    time = _times(duration)
    frequency = rng.uniform([[0.1], [0.35], [0.8]], [[0.3], [0.7], [1.3]], (3, len(posture)))
    phase = rng.uniform(0, 2 * np.pi, frequency.shape)
    share = np.array([1.0, 0.5, 0.2])[:, None]
    waves = (share * np.sin(2 * np.pi * frequency * time[:, None, None] + phase)).sum(axis=1)
    return posture + amplitude * _window(time, duration) * waves


def _triangle(cycles: int, posture: np.ndarray, period: float, speed: float) -> np.ndarray:
    """Back and forth at a constant speed, neighbours in opposite directions; round corners, at rest at both ends."""
    time = _times(cycles * period + 4 * CORNER) - 2 * CORNER
    phase = np.clip(time / period, 0.0, cycles) % 1.0
    wave = speed * period * np.where(phase < 0.25, phase, np.where(phase < 0.75, 0.5 - phase, phase - 1.0))
    width = round(CORNER / PERIOD)
    kernel = np.convolve(np.full(width, 1.0 / width), np.full(width, 1.0 / width))
    return posture + np.convolve(wave, kernel, "same")[:, None] * np.where(np.arange(len(posture)) % 2, -1.0, 1.0)


def _move(start: np.ndarray, end: np.ndarray, duration: float) -> np.ndarray:
    share = np.linspace(0.0, 1.0, len(_times(duration)))[:, None]
    return start + share**3 * (10.0 - 15.0 * share + 6.0 * share**2) * (end - start)

"""Recordings of drives that close their own position loop: targets and gains, not torques."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from np_blind.baselines.closed_loop import Stretch, stretch

KEYS = ("time", "dof_pos", "dof_vel", "des_dof_pos", "des_dof_torque", "kp", "kd")
LAW_TOLERANCE = 0.02  # of the largest torque
JITTER = 0.05  # of the period


def read_drive_log(path: str | Path, joints: int, period: float) -> Stretch:
    """The first `joints` joints of an .npz log of targets and gains, brought to `period` s.

    Arrays time (n,) s, dof_pos, dof_vel, des_dof_pos (n, m) rad, rad/s, des_dof_torque (n, m) Nm, kp, kd
    (m,): the drives' law is kp (des_dof_pos - dof_pos) - kd dof_vel, evaluated much faster than logged; so
    targets are held, and the law runs at `period`. Raises ValueError, naming what was expected and found.
    """
    with np.load(path, allow_pickle=False) as file:
        missing = [key for key in KEYS if key not in file.files]
        if missing:
            raise ValueError(f"{path}: expected {', '.join(KEYS)}; {', '.join(missing)} missing")
        time, *columns, stiffness, damping = (np.asarray(file[key], dtype=float) for key in KEYS)
    shapes = {column.shape for column in columns}
    if len(shapes) != 1 or (shape := shapes.pop())[:1] != time.shape or shape[1] < joints:
        raise ValueError(f"{path}: expected {time.size} rows of {joints} joints at least, got {shapes or shape}")
    position, velocity, target, torque = (column[:, :joints] for column in columns)
    stiffness, damping = stiffness[:joints], damping[:joints]
    if not all(np.isfinite(column).all() for column in (time, position, velocity, target, torque)):
        raise ValueError(f"{path}: expected finite numbers")
    steps = np.diff(time)
    if np.abs(steps / np.median(steps) - 1).max() > JITTER:
        raise ValueError(f"{path}: expected even steps of time, got {steps.min():.4f} to {steps.max():.4f} s")
    law = stiffness * (target - position) - damping * velocity
    if (miss := np.abs(law - torque).max()) > LAW_TOLERANCE * np.abs(torque).max():
        raise ValueError(f"{path}: expected the torque of the law, which is {miss:.2f} Nm away: other gains or signs?")
    logged = stretch(
        Path(path).stem,
        float((time[-1] - time[0]) / (time.size - 1)),
        position,
        velocity,
        target,
        law,
        stiffness,
        damping / np.sqrt(stiffness),
    )
    return logged.resampled(period)

"""Signals that cannot be what was measured: constant while their joint moves, or a position that jumps by whole turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.recordings.signals import Log
from sim2real.thresholds import THRESHOLDS
from sim2real.wiring.fault import WiringFault

WIRING = THRESHOLDS.wiring
TURN = 2 * np.pi


def find_signal_fault(log: Log, names: Sequence[str]) -> WiringFault | None:
    """Of a log of the named joints: velocity or effort equal to the last bit although the joint moves, or a position that wraps."""
    moves = np.ptp(log.position, axis=0) > WIRING.moved
    signals = {"velocity": log.velocity, "effort": log.torque}
    for part, values in signals.items():
        flat = np.flatnonzero(moves & (np.ptp(values, axis=0) == 0))
        if flat.size:
            joints = tuple(names[j] for j in flat)
            return WiringFault(
                "constant",
                "joint_states",
                f"The {part} of joint_states does not change while the joint moves: {', '.join(joints)}.",
                f"Record the {part} as it is measured.",
                joints,
            )
    step, reach = np.diff(log.position, axis=0), np.abs(log.velocity[1:]) * np.diff(log.time)[:, None]
    wraps = (np.abs(np.abs(step) - TURN) < WIRING.wrap) & (reach < WIRING.wrap)
    if wraps.any():
        joints = tuple(names[j] for j in np.flatnonzero(wraps.any(axis=0)))
        row = int(np.flatnonzero(wraps.any(axis=1))[0])
        return WiringFault(
            "jump",
            "joint_states",
            f"The position of joint_states jumps by a whole turn at {', '.join(joints)}, first {log.time[row + 1]:.3f} s from the start.",
            "Unwrap the position: add or subtract 2 pi from each jump on.",
            joints,
        )
    return None

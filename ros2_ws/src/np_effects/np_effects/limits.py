"""Limits of a drive act on all that it gives, the gravity that it compensates included; in some on the command alone.

Which of the two is asked of the recording, joint by joint, before the limit is: whatever is limited, one of the readings
leaves less of what was measured at every level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from np_effects.evidence import Drive
from np_effects.record import Quantity

GRAVITY_APART = Quantity("gravity_apart", "1", 0.0, 1.0)  # 1: the limit is of the command, without gravity
Limited = Callable[[Drive, np.ndarray, float], np.ndarray]
"""What a limit leaves of torques (n,) Nm."""


def lost(d: Drive, joint: int, limited: Limited, limit: float, apart: bool) -> np.ndarray:
    """Change (n,) Nm of a joint's torque by a limit."""
    whole = d.arrived[:, joint] + (0.0 if apart else d.gravity[:, joint])
    return limited(d, whole, limit) - whole


def fastest(d: Drive, joint: int, apart: bool) -> float:
    """Largest rate Nm/s of what a limit would act on."""
    whole = d.arrived[:, joint] + (0.0 if apart else d.gravity[:, joint])
    return float(np.abs(np.diff(whole)).max() / d.period)


def is_apart(d: Drive, joint: int, limited: Limited, levels: dict[bool, Sequence[float]]) -> bool:
    """Whether gravity apart is the reading under which the best of its levels leaves less of what was measured."""
    residual = d.measured[:, joint] - d.arrived[:, joint]
    left = {
        apart: min(np.square(residual - lost(d, joint, limited, level, apart)).sum() for level in levels[apart])
        for apart in (False, True)
    }
    return bool(left[True] < left[False])

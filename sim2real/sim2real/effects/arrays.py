"""Which library's arrays the hooks of effects get, and what holds an arm against gravity in it.

Hooks are written for NumPy and PyTorch alike (`np_common.rotations.namespace`): one arm of the bridge and thousands of
training behave by the same lines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim2real.effects.gravity import GravityTorque


@dataclass(frozen=True)
class Arrays:
    """A library of arrays."""

    array: Callable[[np.ndarray], np.ndarray]
    """Makes an array of the library from numbers."""
    hold: Callable[..., Callable[[np.ndarray], np.ndarray]]
    """(panda, tilt) -> function from angles (..., 7) rad to the torque (..., 7) Nm that holds that arm."""


NUMPY = Arrays(np.asarray, GravityTorque)

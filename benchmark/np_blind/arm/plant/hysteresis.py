"""Friction with a memory, for all joints of many arms at once: arrays broadcast, steps of h seconds.

Both elements are passive: over any motion they take in more energy than they give back.
"""

from __future__ import annotations

import numpy as np

SLIDING_DAMPING = 2.0  # Nms/rad, of a bristle that has not broken away


def prandtl(
    bend: np.ndarray, speed: np.ndarray, forward: np.ndarray, backward: np.ndarray, stiffness: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """(bend, friction Nm) after a step of Prandtl's element: a bristle that bends, then slides.

    bend rad; speed rad/s; forward, backward Nm: greatest friction against motion either way; stiffness
    Nm/rad.
    The return mapping of plasticity: a trial that is too strong is put back on the bound.
    """
    bend = bend + speed * h
    viscous = SLIDING_DAMPING * speed
    friction = np.minimum(np.maximum(stiffness * bend + viscous, -backward), forward)
    # What is kept is elastic: the bound holds for it alone, so that its energy is never more than was put in.
    elastic = np.minimum(np.maximum(stiffness * bend, -backward), forward)
    return elastic / stiffness, friction


def lugre(
    bend: np.ndarray, speed: np.ndarray, level: np.ndarray, stroke: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """(bend, friction Nm) after a step of LuGre's element (Canudas de Wit et al., IEEE TAC 1995).

    dz/dt = v - |v| z / stroke, F = (level / stroke) z: Dahl's limit, no bristle damping. Exact for a speed
    that is constant over the step, however fast. level Nm, stroke rad.
    """
    rest = np.copysign(stroke, speed)
    bend = rest + (bend - rest) * np.exp(-np.abs(speed) * h / stroke)
    return bend, level / stroke * bend


def bouc_wen(bend: np.ndarray, rate: np.ndarray, limit: np.ndarray, h: float) -> np.ndarray:
    """Bouc and Wen's hysteretic deflection rad, n = 1: dz/dt = u' - |u'| z / limit. rate rad/s, limit rad."""
    rest = np.copysign(limit, rate)
    return rest + (bend - rest) * np.exp(-np.abs(rate) * h / limit)

"""How long an identification looks: apart from what looks, whose libraries are slow to import."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Budget:
    """How long to look. window s: length of a replayed stretch; windows: of each joint, those in which it
    moves most; generations, population: of CMA-ES, a joint; iterations: of Gauss-Newton; threads: 0 for all
    cores."""

    window: float = 4.0
    windows: int = 2
    generations: int = 30
    population: int = 8
    iterations: int = 15
    threads: int = 0

"""How an environment is set up, and how near its force reflex is to the robot's."""

from __future__ import annotations

from dataclasses import dataclass

from np_control.impedance import DAMPING_RATIO_MIN
from np_training.physics.config import PhysicsConfig
from np_training.tasks.randomisation import NOMINAL_CONDITIONS, Conditions
from np_training.tasks.rewards import RewardConfig

LOOSE_FORCE = 10.0  # times the force reflex's thresholds at strictness 0: what an untrained policy's blows come to


@dataclass(frozen=True)
class EnvironmentConfig:
    """Episodes of all worlds."""

    worlds: int = 24576
    """How many run at once."""
    limit: int = 100
    """Policy steps an episode."""
    hold: int = 1
    """Policy steps in a row within tolerance that count as success."""
    tolerance: float = 1.0
    """Share of the task's tolerance."""
    seed: int = 0
    """Of all random numbers."""
    shares: tuple[float, ...] = (1.0,)
    """Of each kind of task (`TaskConfig.kinds`), the task's own first."""
    explore: float = 0.0
    """Share of contacts at any point of the object, which the pre-contact policy did not choose."""
    reflex: bool = False
    """Whether a joint beyond its limits of speed or position ends the episode, as `np_sim_bridge` reports a fault there."""
    force_reflex: bool = True
    """Whether forces beyond the reflex's thresholds end the episode."""
    strictness: float = 1.0
    """0 where learning begins, 1 where it ends: how much of the prices on touches is charged; see `force_scale`."""
    damping_floor: float = DAMPING_RATIO_MIN
    """Least damping ratio of an action."""
    reward: RewardConfig = RewardConfig()
    """Its terms and weights."""
    physics: PhysicsConfig = PhysicsConfig()
    """How the scene is stepped."""
    conditions: Conditions = NOMINAL_CONDITIONS
    """What is drawn in each episode and step."""


def force_scale(strictness: float) -> float:
    """Factor of the force reflex's thresholds, geometric from LOOSE_FORCE at 0 to 1 at 1, as the residual limits tighten."""
    return LOOSE_FORCE ** (1 - strictness)

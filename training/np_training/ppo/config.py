"""How policies are learned: one configuration of the learner, one of the training. Needs no PyTorch: commands read their options with it."""

from __future__ import annotations

from dataclasses import dataclass

from np_training.ppo.curriculum import CurriculumConfig
from np_training.tasks.randomisation import PAPER, Conditions


@dataclass(frozen=True)
class PPOConfig:
    """discount; trace: lambda of generalised advantage estimation; clip; epochs, minibatches a rollout;
    entropy: weight of the bonus; target_kl: the learning rate falls by 1.5 above twice it and rises below
    half of it; rate: bounds of the learning rate."""

    discount: float = 0.99
    trace: float = 0.95
    clip: float = 0.2
    epochs: int = 5
    minibatches: int = 8
    entropy: float = 0.0005
    target_kl: float = 0.01
    rate: tuple[float, float] = (2e-5, 1e-3)
    gradient_norm: float = 1.0


@dataclass(frozen=True)
class TrainConfig:
    """How both policies are trained, beside the learner."""

    rollout: int = 12
    """Policy steps between updates."""
    hold: int = 3
    """Policy steps at the goal that count as success under full randomisation; one without any."""
    tolerance: float = 1.0
    """Share of the domain's tolerance within which they have to be under full randomisation; all of it without any."""
    reflex: bool = True
    """Whether joints beyond their limits of speed and range end an episode once randomisation begins."""
    pre_least: int = 64
    """Episodes without which the pre-contact policy is left as it is."""
    stiffness: float = 0.0
    """Stiffness that an untrained policy commands, -1 to 1 of its range."""
    deviation: float | None = None
    """Largest standard deviation of the actions drawn under full randomisation, as a share of their range; it falls from 1 with it. A
    robot runs the mean action, which goes round in circles that drawn actions leave."""
    conditions: Conditions = PAPER
    """What is randomised in the end; `force_margin` of it holds from the beginning."""
    curriculum: CurriculumConfig = CurriculumConfig()
    """How tasks become harder."""

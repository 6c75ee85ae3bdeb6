"""How policies are learned: one configuration of the learner, one of the training. Needs no PyTorch: commands read their options with it."""

from __future__ import annotations

from dataclasses import dataclass

from np_training.ppo.curriculum import CurriculumConfig
from np_training.tasks.randomisation import PAPER, Conditions


@dataclass(frozen=True)
class PPOConfig:
    """The learner's constants."""

    discount: float = 0.99
    """Of the return, a policy step."""
    trace: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Of the ratio of probabilities."""
    epochs: int = 5
    """Over a rollout."""
    minibatches: int = 8
    """An epoch."""
    entropy: float = 0.0005
    """Weight of the bonus."""
    target_kl: float = 0.01
    """The learning rate falls by 1.5 above twice this divergence and rises below half of it."""
    rate: tuple[float, float] = (2e-5, 1e-3)
    """Bounds of the learning rate."""
    gradient_norm: float = 1.0
    """Largest norm of a gradient."""


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

"""How policies are learned: one configuration of the learner, one of the training. Needs no PyTorch: commands read their options with it."""

from __future__ import annotations

from dataclasses import dataclass

from np_training.ppo.curriculum import CurriculumConfig


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
    """rollout: steps between updates; hold: steps at the goal that count as success once randomised, and
    tolerance: the share of the domain's within which they have to be then; reflex: whether joints beyond their
    limits end an episode then; pre_least: episodes without which the pre-contact policy is left as it is;
    start: contact where the pre-contact policy chooses, else see `fixed_contact`; stiffness: that an untrained
    policy commands, -1 to 1 of its range; deviation: that actions are drawn with at most, of their range: what a robot runs
    is the mean, which goes round in circles that drawn actions leave; privileged: whether the critic sees more than the policy
    (`Environment.observe`), else nothing but zeros there; adaptive_joint_range: see `joint_range`; conditions: what is randomised
    once the limits are tight, by its name in `CONDITIONS`."""

    rollout: int = 12
    hold: int = 3
    tolerance: float = 1.0
    reflex: bool = True
    pre_least: int = 64
    start: str = "contact"
    stiffness: float = 0.0
    privileged: bool = True
    deviation: float | None = None
    adaptive_joint_range: bool = False
    conditions: str = "paper"
    curriculum: CurriculumConfig = CurriculumConfig()

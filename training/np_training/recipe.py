"""A recipe: how the policies of a domain are made from nothing, stage by stage, and how they are judged. One YAML file a domain.

The file has `domain`, `settings` for all stages, `stages` with what each has of its own, `distil` and `judge`. Nothing in it depends on the
machine: a stage ends at a success or after a number of policy steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN
from np_description.domains import DOMAINS
from np_training.physics.config import STEPPING, PhysicsConfig
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.tasks.randomisation import Conditions, find_conditions
from np_training.tasks.rewards import RewardConfig


class RecipeError(ValueError):
    """A file that is no recipe; one line that names it, what was expected and what came."""


@dataclass(frozen=True)
class Settings:
    """Of one stage. None: the task's own value (np_training.tasks)."""

    contact: str | None = None
    """Key of `STEPPING`; None: that in which the domain is learned."""
    conditions: str = "paper"
    """Key of `CONDITIONS`: what is randomised in the end."""
    changes: Mapping[str, object] = field(default_factory=dict)
    """Fields of the conditions that differ from that set."""
    success: float | None = None
    """The stage ends at this success of fully randomised episodes."""
    steps: float = float("inf")
    """Million policy steps, after which the stage ends anyway."""
    residual: bool = CurriculumConfig.residual
    """See `CurriculumConfig`."""
    growth: int = CurriculumConfig.growth
    """See `CurriculumConfig`."""
    limit: int | None = None
    """Policy steps an episode."""
    practice: float | None = None
    """Share of practice at the beginning."""
    explore: float | None = None
    """Share of contacts chosen at random at the beginning."""
    kept: float = CurriculumConfig.kept
    """Share of practice that stays to the end."""
    stiffness: float = TrainConfig.stiffness
    """See `TrainConfig`."""
    deviation: float | None = TrainConfig.deviation
    """See `TrainConfig`."""
    hold: int = TrainConfig.hold
    """See `TrainConfig`."""
    tolerance: float | None = None
    """Share of the domain's tolerance; None: what the domain aims at."""
    rollout: int = TrainConfig.rollout
    """Policy steps between updates."""
    discount: float = PPOConfig.discount
    """Of the return, a policy step."""
    entropy: float = PPOConfig.entropy
    """Weight of the entropy bonus."""
    target_kl: float = PPOConfig.target_kl
    """Divergence that steers the learning rate."""
    rate_limit: float = PPOConfig.rate[1]
    """Largest learning rate."""
    damping_floor: float = DAMPING_RATIO_MIN
    """Least damping ratio of an action."""
    largest_turn: float | None = None
    """From start to goal, rad; None: the domain's."""
    max_opening: float | None = None
    """Of one finger, m; None: the domain's."""
    contacts: int = PhysicsConfig.contacts
    """Capacity of contacts a world."""
    constraints: int = PhysicsConfig.constraints
    """Capacity of constraints a world."""
    reward: Mapping[str, float] = field(default_factory=dict)
    """Fields of `RewardConfig` that differ from its defaults; `far` is the task's otherwise."""

    def __post_init__(self) -> None:
        if self.contact is not None and self.contact not in STEPPING:
            raise ValueError(f"contact: expected one of {', '.join(STEPPING)}, got {self.contact!r}")
        known = {f.name for f in dataclasses.fields(RewardConfig)}
        if unknown := set(self.reward) - known:
            raise ValueError(f"reward: expected fields of {', '.join(sorted(known))}, got {', '.join(sorted(unknown))}")
        if not DAMPING_RATIO_MIN <= self.damping_floor < DAMPING_RATIO_MAX:
            raise ValueError(
                f"damping_floor: expected {DAMPING_RATIO_MIN:g} to {DAMPING_RATIO_MAX:g}, got {self.damping_floor:g}"
            )
        if self.growth < 1:
            raise ValueError(f"growth: expected at least 1 stage, got {self.growth}")
        self.drawn  # noqa: B018  raises for conditions that there are not

    @property
    def drawn(self) -> Conditions:
        """The conditions with their changes."""
        return find_conditions(self.conditions, self.changes)


@dataclass(frozen=True)
class Judged:
    """A row of an evaluation."""

    name: str
    """By which the row is found again."""
    conditions: Conditions
    """What is drawn for its episodes."""


@dataclass(frozen=True)
class Recipe:
    """A domain's recipe."""

    domain: str
    """Name of the domain."""
    stages: tuple[Settings, ...]
    """In their order."""
    distil: Mapping[str, object] = field(default_factory=dict)
    """Options of np_training.distill, by name."""
    judge: tuple[Judged, ...] = ()
    """What the trained policies are judged under."""


def read_recipe(path: Path, changes: Mapping[str, object] | None = None) -> Recipe:
    """The recipe in a file, `changes` made to the settings of all its stages. Raises RecipeError."""
    try:
        text = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise RecipeError(f"{path}: expected a recipe, got: {str(error).splitlines()[0]}") from error
    known = {"domain", "settings", "stages", "distil", "judge"}
    if not isinstance(text, dict) or set(text) - known or text.get("domain") not in DOMAINS:
        raise RecipeError(f"{path}: expected {', '.join(sorted(known))} with a domain of {', '.join(DOMAINS)}")
    common = text.get("settings") or {}
    try:
        stages = tuple(settings_of({**common, **(own or {}), **(changes or {})}) for own in text.get("stages") or [{}])
        judged = tuple(
            Judged(row["name"], find_conditions(row.get("conditions", "nominal"), row.get("changes")))
            for row in text.get("judge") or ()
        )
    except (ValueError, KeyError, TypeError) as error:
        raise RecipeError(f"{path}: {error}") from error
    return Recipe(text["domain"], stages, text.get("distil") or {}, judged)


def settings_of(values: Mapping[str, object]) -> Settings:
    """Settings with these fields. Raises ValueError for a field that there is not."""
    known = {f.name for f in dataclasses.fields(Settings)}
    if unknown := set(values) - known:
        raise ValueError(f"settings: expected fields of {', '.join(sorted(known))}, got {', '.join(sorted(unknown))}")
    return Settings(**values)

"""The curriculum: residual limits tighten as success rises, then domain randomisation begins (paper).

Ours beside it: randomisation grows in steps as the limits tighten, force reflex and prices on touches with both; and a share of the
episodes is practice (`np_training.tasks.practice`), until the domain's own tasks succeed.
"""

from __future__ import annotations

from dataclasses import dataclass

from np_policy.action import RESIDUAL_LIMITS_FINAL, RESIDUAL_LIMITS_INITIAL, ResidualLimits

STAGES = 10  # geometric steps from the initial to the final residual limits (paper)


@dataclass(frozen=True)
class CurriculumConfig:
    """How success moves the curriculum."""

    residual: bool = True
    """Whether it starts with loose limits (paper); else all stages have zeta*, for a policy that is trained on its task."""
    advance_at: float = 0.8
    """Success that ends a stage (paper: that tightens the limits)."""
    growth: int = 10
    """Stages after the tightest limits in which randomisation grows to its full ranges; 1: at once (paper)."""
    practice: float = 0.0
    """Share of practice at no success."""
    explore: float = 0.0
    """Share of contacts chosen at random at no success."""
    practised_at: float = 0.6
    """Success at which practice and random contacts are gone."""
    kept: float = 0.0
    """Share of practice that stays."""
    least_weight: float = 0.03
    """Of a kind of practice that always or never succeeds; one that succeeds every other time has 0.25 more."""


def stage_limits(stage: int) -> ResidualLimits:
    """Residual limits of a curriculum stage, 0 (loose) to STAGES (tight), geometric in between (paper)."""
    share = min(stage, STAGES) / STAGES
    return ResidualLimits(
        *(
            a * (b / a) ** share
            for a, b in (
                (RESIDUAL_LIMITS_INITIAL.position, RESIDUAL_LIMITS_FINAL.position),
                (RESIDUAL_LIMITS_INITIAL.rotation, RESIDUAL_LIMITS_FINAL.rotation),
            )
        )
    )


class Curriculum:
    """Where a training is.

    stage: 0 to STAGES `stage_limits`, then `growth` stages in which randomisation grows; success: running mean over about `window`
    episodes, half of which have to end within a stage before it is left; practised: the same for each kind of practice.
    """

    def __init__(self, window: int, config: CurriculumConfig = CurriculumConfig(), practices: int = 0) -> None:
        self.config, self.window = config, window
        self.practised = [0.0] * practices
        self.stage = 0
        self.success, self.episodes = 0.0, 0

    @property
    def last(self) -> int:
        """The stage in which everything is as strict as it becomes."""
        return STAGES + self.config.growth

    @property
    def randomisation(self) -> float:
        """Share, 0 to 1, of the randomisation that is on: see `Conditions.at`."""
        return max(self.stage - STAGES, 0) / self.config.growth

    @property
    def limits(self) -> ResidualLimits:
        """Residual limits now."""
        return stage_limits(self.stage if self.config.residual else STAGES)

    @property
    def strictness(self) -> float:
        """0 where learning begins, 1 in the last stage: see `EnvironmentConfig`."""
        return self.stage / self.last

    @property
    def _left(self) -> float:
        return max(0.0, 1 - self.success / self.config.practised_at)

    @property
    def explore(self) -> float:
        """Share of exploring contacts now."""
        return self.config.explore * self._left

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of each kind of task now, the domain's own first: of practice most where success varies
        most, since an episode that ends as all others do teaches nothing."""
        practice = max(self.config.practice * self._left, self.config.kept) if self.practised else 0.0
        weights = [p * (1 - p) + self.config.least_weight for p in self.practised]
        return (1 - practice, *(practice * weight / sum(weights) for weight in weights))

    def go_back(self, stage: int) -> None:
        """Begin `stage` (0 to STAGES) anew, as if nothing were known of how well it goes."""
        if not 0 <= stage <= STAGES:
            raise ValueError(f"stage: expected 0 to {STAGES}, got {stage}")
        self.stage, self.success, self.episodes = stage, 0.0, 0
        self.practised = [0.5] * len(self.practised)

    def resume(self, stage: int, growth: int) -> None:
        """Go on in the stage of a training whose randomisation grew in `growth` stages, with as much of it."""
        beyond = max(stage - STAGES, 0) / growth
        self.stage = min(stage, STAGES) + round(beyond * self.config.growth)

    def practise(self, number: int, success: float, episodes: int) -> None:
        """Count episodes that ended of practice `number`, `success` their share of successes."""
        weight = min(episodes * max(len(self.practised), 1) / self.window, 1.0)
        self.practised[number] += weight * (success - self.practised[number])

    def advance(self, success: float, episodes: int) -> bool:
        """Count episodes that ended, `success` their share of successes; whether a new stage begins."""
        if not episodes:
            return False
        weight = min(episodes / self.window, 1.0)
        self.success = success if self.episodes == 0 else (1 - weight) * self.success + weight * success
        self.episodes += episodes
        if self.episodes < self.window // 2 or self.stage == self.last or self.success < self.config.advance_at:
            return False
        self.stage, self.episodes = self.stage + 1, 0
        return True

"""From a recording and the catalogue to cells: every effect's columns wherever it shows, and their sums."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from np_description.panda import NOMINAL
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter
from sim2real.effects.stage import Stage
from sim2real.inference import nuisances
from sim2real.inference.projection import hstack_contiguous
from sim2real.inference.residual_cells import ResidualCell, TimeBlock, make_blocks, make_cell
from sim2real.inference.residual_stages import ResidualStages


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place: joint number or None for the arm; ids of its parameters."""

    effect: EffectRegressor
    joint: int | None
    ids: np.ndarray
    component_joint: int | None = None  # that an effect of the arm sits at

    @property
    def place(self) -> int | None:
        """Number of the joint that it is at, an effect of the arm too; None where that is no single one."""
        return self.component_joint if self.joint is None else self.joint

    def component(self, joints: tuple[str, ...]) -> str:
        """Joint name, or the arm effect's own component."""
        return self.effect.component if self.joint is None else joints[self.joint]


@dataclass(frozen=True, eq=False)
class RegressionProblem:
    """All cells, all candidates, and the parameters (by id) with their priors."""

    context: Context
    cells: tuple[ResidualCell, ...]
    candidates: tuple[Candidate, ...]
    parameters: tuple[Parameter, ...]
    nuisances: tuple[np.ndarray, ...]  # ids by joint
    blocks: tuple[TimeBlock, ...]
    stages: ResidualStages

    def cells_of(self, joint: int) -> list[ResidualCell]:
        """The cells of a joint."""
        return [cell for cell in self.cells if cell.joint == joint]


def make_regression(context: Context) -> RegressionProblem:
    """Columns of every effect in every stage of every joint, and their sums."""
    parameters: list[Parameter] = []

    def new(parts: tuple[Parameter, ...]) -> np.ndarray:
        parameters.extend(parts)
        return np.arange(len(parameters) - len(parts), len(parameters))

    stages = ResidualStages(context)
    nuisance = [
        {stage: new(nuisances.nuisance_parameters(context, stage, joint)) for stage in stages.stages}
        for joint in range(len(context.arm))
    ]
    candidates = []
    for effect in stages.regressors:
        places = [None] if effect.is_arm else range(len(context.arm))
        for joint in places:
            if effect.only_joint is None or effect.only_joint == joint:
                at = context.arm.joints.index(effect.component) if effect.component in context.arm.joints else None
                candidates.append(Candidate(effect, joint, new(_told(context, effect)), at))
    blocks = make_blocks(context)
    cells = []
    for joint in range(len(context.arm)):
        for stage in stages.stages:
            own = stages.mask_reference(stage, nuisances.nuisance_columns(context, stage, joint))
            parts, ids = [own], [nuisance[joint][stage]]
            for candidate in candidates:
                if candidate.joint in (None, joint):
                    columns = stages.columns(candidate.effect, stage, joint)
                    if columns is not None:
                        parts.append(columns)
                        ids.append(candidate.ids)
            shown, columns = np.concatenate(ids), hstack_contiguous(parts)
            cells.append(make_cell(stages, stage, joint, shown, columns, blocks, parameters))
            if stage is Stage.DYNAMICS:  # the same columns and nuisances in the rows about reversals
                cells.append(make_cell(stages, stage, joint, shown, columns, blocks, parameters, at_reversal=True))
    ids = tuple(np.concatenate(list(own.values())) for own in nuisance)
    return RegressionProblem(context, tuple(cells), tuple(candidates), tuple(parameters), ids, blocks, stages)


def _told(context: Context, effect: EffectRegressor) -> tuple[Parameter, ...]:
    """Parameters of an effect, in a stronger arm than the Panda with as much more room. What any arm's links are off by does
    not change: between two recordings of an arm any size of it is worth naming."""
    parts = tuple(_sized(p, context.arm.torque_limit.max() / NOMINAL.torque_limit.max()) for p in effect.parameters)
    if context.reference and ARM_EFFECTS[effect.id].module in ("rigid_body", "joint_dynamics"):
        return tuple(replace(p, least=0.0) for p in parts)
    return parts


def _sized(parameter: Parameter, stronger: float) -> Parameter:
    """A torque or a mass of an arm that is so many times as strong; a lower bound that is none of taste, but of physics (no
    less than no friction), stays."""
    if stronger <= 1 or not parameter.unit.startswith(("Nm", "kg")):
        return parameter
    is_free = parameter.lower == -parameter.upper
    return replace(
        parameter,
        lower=stronger * parameter.lower if is_free else parameter.lower,
        upper=stronger * parameter.upper,
        prior=stronger * parameter.prior,
    )

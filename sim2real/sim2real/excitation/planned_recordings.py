"""What an experiment would record, before anybody runs it: its motion, followed perfectly by the nominal arm.

The recordings planned have neither noise nor gap: they are there for what effects would do to such a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from np_control.impedance import damping
from np_control.safety import LIMITS
from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.evidence import Context
from sim2real.effects.recurrences import smooth_sign
from sim2real.effects.registry import make_regressors
from sim2real.effects.regressor import EffectRegressor
from sim2real.excitation.suite import Segment, make_experiment
from sim2real.inference import nuisances
from sim2real.inference.context import make_context
from sim2real.inference.regression import RegressionProblem
from sim2real.inference.residual_cells import ResidualCell, TimeBlock, make_cell
from sim2real.inference.residual_stages import ResidualStages
from sim2real.recordings.signals import Commands, Log

PERIOD = LIMITS.period
COARSE = 4  # periods


def plan_log(segment: Segment, arm: Arm, like: Log) -> Log:
    """A recording of one segment with the channels that `like` has, by an arm without any gap."""
    time = np.arange(0.0, segment.duration, PERIOD)
    q, dq, rate = _follow_segment(segment, time)
    rigid_part = _rigid_body_torque(arm, segment, time)
    commanded = rigid_part + smooth_sign(dq) * arm.frictionloss + dq * arm.damping
    measured = np.vstack([commanded[:1], commanded[:-1]])  # that of the period before the stamp
    if like.with_gravity:
        measured = measured + rigid.gravity_torque(arm, q)
    commands = None
    if like.commands is not None:
        kp = np.tile(segment.gains[0], (len(time), 1))
        kd = damping(kp, segment.gains[1])
        target = q + (commanded - rigid_part + kd * dq) / kp - kd / kp * dq
        commands = Commands(np.arange(len(time)), target, dq, commanded, time + PERIOD / 2, kp, kd)
    motor = None if like.motor is None else q.copy()
    return Log(segment.name, time, q, dq, measured, time - PERIOD / 2, like.with_gravity, commands, motor)


def plan_context(names: Sequence[str], context: Context) -> Context:
    """The context of recordings of these experiments, one trajectory each, by the arm and setup of a recorded one."""
    logs = [plan_log(make_experiment(name), context.arm, context.logs[0]) for name in names]
    planned = make_context(logs, context.arm)
    held = None
    if planned.drive is not None and context.held is not None:
        # Packets that will be lost: as many as were.
        held = np.random.default_rng(0).random(len(planned.drive.time)) < context.held_share
    return replace(
        planned,
        held=held,
        held_share=context.held_share,
        held_error=context.held_error,
        ripples=context.ripples,
        quanta=context.quanta,
    )


def plan_cells(
    design: RegressionProblem, names: Sequence[str], members: Sequence[int], joints: Sequence[int]
) -> list[ResidualCell]:
    """Sums of what these candidates and the nuisances would do in each experiment at each stage of some joints.

    They have the whitening and the parameters of the design's cells, and one block an experiment.
    """
    context = plan_context(names, design.context)
    stages, cells = ResidualStages(context), []
    effects = {m: _rebuild_effect(context, design.candidates[m].effect) for m in members}
    blocks = tuple(TimeBlock(n, -np.inf, np.inf) for n in range(len(names)))
    for cell in design.cells:
        if cell.joint not in joints or cell.stage not in stages.stages:
            continue
        own = [i for i in cell.ids if i in design.nuisances[cell.joint]]
        ids, matrix = [np.array(own, int)], [nuisances.nuisance_columns(context, cell.stage, cell.joint)]
        for m in members:
            candidate = design.candidates[m]
            if candidate.joint in (None, cell.joint):
                columns = stages.columns(effects[m], cell.stage, cell.joint)
                if columns is not None:
                    ids.append(candidate.ids)
                    matrix.append(columns)
        cells.append(
            make_cell(
                stages,
                cell.stage,
                cell.joint,
                np.concatenate(ids),
                np.hstack(matrix),
                blocks,
                design.parameters,
                cell.whiten,
                cell.at_reversal,
            )
        )
    return cells


def _follow_segment(segment: Segment, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (n, 7) of a segment that is followed perfectly; at rest outside of it."""
    path = CubicHermiteSpline(segment.times, segment.positions, segment.velocities)
    inside = np.clip(time, 0.0, segment.duration)
    return path(inside), path(inside, 1), np.gradient(path(inside, 1), time, axis=0)


def _rigid_body_torque(arm: Arm, segment: Segment, time: np.ndarray) -> np.ndarray:
    """Torque (n, 7) Nm of the motion without gravity and friction: of every few rows, and smooth in between."""
    coarse = np.linspace(0.0, time[-1], 2 + len(time) // COARSE)
    q, dq, rate = _follow_segment(segment, coarse)
    return CubicSpline(coarse, rigid.feedforward_torque(arm, q, dq, rate))(time)


def _rebuild_effect(context: Context, effect: EffectRegressor) -> EffectRegressor:
    """The same effect with columns for another context: those of rigid bodies are tied to their motion."""
    if ARM_EFFECTS[effect.id].module != "rigid_body":
        return effect
    return next(e for e in make_regressors(context) if e.key == effect.key and e.component == effect.component)

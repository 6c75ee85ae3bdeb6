"""Torque constants of motors, settled together with the effects that spoil a first estimate.

A payload that the nominal arm does not model loads every joint: constants estimated without it take up part of it. Where the
constants of a recording are estimated (`recordings.motor_current`), every joint has a nuisance: the share by which its constant
is off. It is read off the best model of a short search, taken out of the torque, and estimated again: first as a share of the
torque itself, which is exact whatever the model lacks, then, free of the sensor's noise, of the torque that this model predicts.
"""

from __future__ import annotations

import numpy as np

from sim2real.arm.model import Arm
from sim2real.effects.stage import Stage
from sim2real.inference.context import make_context
from sim2real.inference.nuisances import TORQUE_CONSTANT
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch, fits_by_joint
from sim2real.recordings.motor_current import current_to_torque
from sim2real.recordings.signals import Log, sample_logs
from sim2real.thresholds import THRESHOLDS

CURRENT = THRESHOLDS.current


def refine_torque_constants(logs: list[Log], arm: Arm) -> tuple[list[Log], np.ndarray | None]:
    """(logs with torques by constants that go with the effects found, the torque (n, k) Nm of their samples by the model
    found: `Context.constant`); logs whose torque was measured as they are, and None.

    A constant that the effects change by a factor of more than `CURRENT.refined` is unknown: NaN.
    """
    if all(log.per_ampere is None for log in logs):
        return logs, None
    says, first = None, next(log.per_ampere for log in logs if log.per_ampere is not None)
    for _ in range(CURRENT.rounds):
        is_first = says is None
        constant = sample_logs(logs).torque if is_first else says
        search = ModelSearch(make_regression(make_context(logs, arm, constant=constant)))
        share, says = _found(search)
        factor = 1 - share if is_first else 1 / (1 + share)
        logs = [log if log.per_ampere is None else current_to_torque(log, log.per_ampere * factor) for log in logs]
        if not is_first and np.abs(share).max() < CURRENT.settled:
            break
    ratio = next(log.per_ampere for log in logs if log.per_ampere is not None) / first
    known = np.where((ratio > 1 / CURRENT.refined) & (ratio < CURRENT.refined), 1.0, np.nan)
    return [log if log.per_ampere is None else current_to_torque(log, log.per_ampere * known) for log in logs], says


def _found(search: ModelSearch) -> tuple[np.ndarray, np.ndarray]:
    """(share (k,) that each joint's nuisance has, torque (n, k) Nm that the best model of a short search otherwise predicts)."""
    design = search.design
    says, share = design.context.prediction.total.copy(), np.zeros(len(design.context.arm))
    fits = fits_by_joint(search, search.run(1).members)
    for cell in (c for c in design.cells if c.stage is Stage.DYNAMICS and not c.at_reversal):
        ids, fit = fits[cell.joint]
        values = dict(zip(ids, fit.parameters.mean(axis=0)))
        for column, i in zip(cell.matrix.T, cell.ids):
            if design.parameters[i].name == TORQUE_CONSTANT:
                share[cell.joint] = values[i]
            else:
                says[:, cell.joint] += values.get(i, 0.0) * column
    return share, says

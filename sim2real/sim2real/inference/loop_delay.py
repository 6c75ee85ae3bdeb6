"""The delay of the loop, estimated from the recording before the search: one number for all joints.

Every loop is late by some tenths of a millisecond. Commanded and measured torque determine the delay of each joint to some
hundredths of a millisecond, and the median over the joints is not moved by one drive that lags. A delay up to what any
loop has is no gap, and every model may use it; what is beyond is left to the effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim2real.effects.stage import Stage
from sim2real.effects.timing.command_delay import USUAL
from sim2real.inference.fit import fit_parameters
from sim2real.inference.regression import RegressionProblem
from sim2real.thresholds import THRESHOLDS

DELAY = THRESHOLDS.loop_delay

# The spread over the joints: drives hardly differ; motion differs by what the noise of the velocity feigns, which is
# in the command through the damping gain and in the acceleration.
SPREAD = {"command_delay": DELAY.command_spread, "motion_delay": DELAY.motion_spread}
BESIDE = ("packet_loss", "torque_scale", "torque_offset")  # effects that a delay is distinguished from


def estimate_loop_delay(design: RegressionProblem) -> RegressionProblem:
    """The design with the prior of all delays about what this loop has. As it is without commands, and for the change between
    two recordings, of which no delay is usual."""
    if design.context.drive is None or design.context.reference:
        return design
    usual = float(np.clip(loop_delay(design), 0.0, USUAL))
    own = set(np.concatenate(design.nuisances).tolist())
    settled = tuple(
        replace(p, centre=usual, prior=SPREAD[p.name]) if i in own and p.name in SPREAD else p
        for i, p in enumerate(design.parameters)
    )
    return replace(design, parameters=settled)


def loop_delay(design: RegressionProblem) -> float:
    """Delay s of measured against commanded torque: the median over the joints."""
    found = []
    for joint in range(len(design.context.arm)):
        cell = next(c for c in design.cells_of(joint) if c.stage is Stage.DRIVE)
        delay = next(i for i in design.nuisances[joint] if design.parameters[i].name == "command_delay")
        beside = [
            c.ids
            for c in design.candidates
            if c.effect.id in BESIDE and c.joint in (None, joint) and np.isin(c.ids, cell.ids).all()
        ]
        wide = list(design.parameters)
        wide[delay] = replace(
            wide[delay], lower=-DELAY.prior, upper=DELAY.longest * DELAY.prior, prior=DELAY.prior, centre=0.0
        )
        ids = np.concatenate([[delay], *beside])
        found.append(
            fit_parameters([cell], [cell.total[None]], [cell.test_rows.sum()[None]], ids, wide).parameters[0, 0]
        )
    return float(np.median(found))

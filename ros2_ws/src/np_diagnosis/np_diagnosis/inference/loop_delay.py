"""The delay of the loop, from the recording itself: one number for all joints, whatever else is wrong with one.

Every loop is late by some tenths of a millisecond. Commanded and measured torque tell it to hundredths of one in
each joint, and the median over the joints is not moved by a drive that lags. Up to what any loop has it is no
gap, and every structure may use it; what is beyond is left to the effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_diagnosis.effects.timing import USUAL
from np_diagnosis.inference.design import Design
from np_diagnosis.inference.fit import fit
from np_effects.stage import Stage

UNKNOWN = 3e-3  # s, prior of the delay before the recording is asked
# s by which joints differ: drives hardly; motion by what the noise of velocity feigns, for it is in the command
# through the damping gain, and in the acceleration.
APART = {"command_delay": 2e-5, "motion_delay": 1.5e-4}
BESIDE = ("packet_loss", "torque_scale", "torque_offset")  # effects that a delay is told from


def settle_delay(design: Design) -> Design:
    """The design with the prior of all delays about what this loop has. As it is without commands."""
    if design.context.drive is None:
        return design
    usual = float(np.clip(loop_delay(design), 0.0, USUAL))
    own = set(np.concatenate(design.nuisances).tolist())
    settled = tuple(
        replace(p, centre=usual, prior=APART[p.name]) if i in own and p.name in APART else p
        for i, p in enumerate(design.parameters)
    )
    return replace(design, parameters=settled)


def loop_delay(design: Design) -> float:
    """Delay s of measured against commanded torque: the median over the joints."""
    found = []
    for joint in range(len(design.context.arm)):
        cell = next(c for c in design.of(joint) if c.stage is Stage.DRIVE)
        delay = next(i for i in design.nuisances[joint] if design.parameters[i].name == "command_delay")
        beside = [
            c.ids
            for c in design.candidates
            if c.effect.id in BESIDE and c.joint in (None, joint) and np.isin(c.ids, cell.ids).all()
        ]
        wide = list(design.parameters)
        wide[delay] = replace(wide[delay], lower=-UNKNOWN, upper=30 * UNKNOWN, prior=UNKNOWN, centre=0.0)
        ids = np.concatenate([[delay], *beside])
        found.append(fit([cell], [cell.total[None]], [cell.test_rows.sum()[None]], ids, wide).parameters[0, 0])
    return float(np.median(found))

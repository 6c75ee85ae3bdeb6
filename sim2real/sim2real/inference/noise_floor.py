"""The size below which a residual is no evidence: errors that every simulator has and no patch would correct."""

from __future__ import annotations

from sim2real.effects.evidence import Context
from sim2real.effects.stage import Stage
from sim2real.thresholds import THRESHOLDS

VISIBLE = THRESHOLDS.visible
_SHARES = {
    Stage.CONTROLLER: VISIBLE.controller,
    Stage.DRIVE: VISIBLE.drive,
    Stage.DYNAMICS: VISIBLE.dynamics,
}


def noise_floor(context: Context, stage: Stage, joint: int, share: float | None = None) -> float:
    """Smallest RMS that matters of a residual of one stage of one joint, Nm or rad.

    share: of the joint's torque limit (None: that of `THRESHOLDS.visible`). Of the dynamics also a share of the joint's
    own friction, by which it differs from posture to posture; not so of what changed since a reference (there is little
    left of either, once what both recordings may have in common is taken out).
    """
    if stage is Stage.TRANSMISSION:
        return VISIBLE.twist
    least = (_SHARES[stage] if share is None else share) * context.arm.torque_limit[joint]
    if stage is Stage.DYNAMICS and not context.reference:
        least = max(least, VISIBLE.friction * context.arm.frictionloss[joint])
    return float(least)

"""How small a residual may be before it says nothing: what no simulator gets right, and no patch would mend."""

from __future__ import annotations

from np_diagnosis.arm.model import Arm
from np_diagnosis.thresholds import THRESHOLDS
from np_effects.stage import Stage

VISIBLE = THRESHOLDS.visible
_SHARES = {
    Stage.CONTROLLER: VISIBLE.controller,
    Stage.DRIVE: VISIBLE.drive,
    Stage.DYNAMICS: VISIBLE.dynamics,
}


def visible(arm: Arm, stage: Stage, joint: int, share: float | None = None) -> float:
    """Smallest RMS that matters of a residual of one stage of one joint, Nm or rad.

    share: of the joint's torque limit (None: that of `THRESHOLDS.visible`). Of the dynamics also a share of the joint's
    own friction, which comes and goes by more than that from posture to posture and from day to day.
    """
    if stage is Stage.TRANSMISSION:
        return VISIBLE.twist
    least = (_SHARES[stage] if share is None else share) * arm.torque_limit[joint]
    return float(max(least, VISIBLE.friction * arm.frictionloss[joint]) if stage is Stage.DYNAMICS else least)

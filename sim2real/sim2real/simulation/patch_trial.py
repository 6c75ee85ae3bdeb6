"""The patch: what the doctor found, as changes of the nominal arm; tried on the recorded motions before that.

The torque domain decides what is there. Whether the simulator gets closer with it is another question, asked of
the closed loop (`forward`): what makes it depart further from what was recorded is left out, and named.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.thresholds import THRESHOLDS

PATCHING = THRESHOLDS.patching


def make_patch(diagnosis: Diagnosis) -> Patch:
    """The chosen effects, for the simulated arm and for training; none of a joint that stays unexplained."""
    joints = diagnosis.context.arm.joints
    unexplained = {joints[j] for j in diagnosis.unexplained}
    chosen = [f for f in diagnosis.findings if f.is_chosen and f.component not in unexplained]
    return Patch(
        tuple(
            PatchEffect(
                f.effect.id,
                f.component,
                {**{name: e.value for name, e in f.parameters.items()}, **f.effect.constants},
            )
            for f in chosen
        )
    )


def try_patch(diagnosis: Diagnosis) -> tuple[Patch, list[str], dict[str, dict[str, float]] | None]:
    """(the patch, what was left out of it for the harm that it does, r4 by joint: RMS rad of the simulator's
    departure within a shot, nominal and with the patch).

    r4 is None, and the patch not tried, for another arm, or recordings without commands.
    """
    from sim2real.simulation.multiple_shooting import (
        cut_windows,  # the simulator takes a second to import, which a quick look has not
    )

    patch, left_out = make_patch(diagnosis), []
    joints = diagnosis.context.arm.joints
    recorded = cut_windows(diagnosis.context.logs) if joints == NOMINAL.joints else None
    if recorded is None:
        return patch, left_out, None
    old, new = _departures(recorded, [Patch(), patch])
    while patch.effects and np.linalg.norm(new) > PATCHING.worse * np.linalg.norm(old):
        fewer = [Patch(tuple(e for e in patch.effects if e is not one)) for one in patch.effects]
        without = _departures(recorded, fewer)
        least = int(np.argmin(np.linalg.norm(without, axis=1)))
        left_out.append(f"{patch.effects[least].effect} at {patch.effects[least].component}")
        patch, new = fewer[least], without[least]
    if not np.isfinite([old, new]).all():
        return patch, left_out, {"diverged": {"before": 0.0, "after": 0.0}}
    table = {joint: {"before": float(old[j]), "after": float(new[j])} for j, joint in enumerate(joints)}
    return patch, left_out, table


def _departures(recorded, patches: Sequence[Patch]) -> np.ndarray:
    """RMS (P, 7) rad of each patch; infinite where the simulation diverges or has no such arm."""
    from sim2real.simulation.multiple_shooting import rms, simulate_departures

    try:
        return rms(simulate_departures(recorded, patches))
    except (FloatingPointError, ValueError):
        if len(patches) == 1:
            return np.full((1, len(NOMINAL.joints)), np.inf)
        return np.concatenate([_departures(recorded, [patch]) for patch in patches])

"""`held_out` of report.json: what the diagnosis does on motion that neither fit nor choice of effects has seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim2real.consequences import Consequences
from sim2real.diagnosis import Diagnosis


def describe_held_out(diagnosis: Diagnosis, done: Consequences) -> dict | None:
    """Before, after and interval in forward simulation where there is one, else by the equations of motion; None where no motion
    was laid aside."""
    torque, trial, joints = diagnosis.held_out, done.trial, diagnosis.context.arm.joints
    if torque is None:
        return None
    by_torque = {
        "unit": "Nm",
        **_change(torque.before, torque.after, torque.interval, joints, torque.before_joint, torque.after_joint),
    }
    if trial is None or not np.isfinite(trial.after).all():
        change = {"method": "equations of motion", **by_torque}
    else:
        old, new = (float(np.sqrt(np.square(rms).mean())) for rms in (trial.before, trial.after))
        change = {
            "method": "forward simulation",
            "unit": "rad",
            **_change(old, new, trial.interval, joints, trial.before, trial.after),
        }
    return {
        **change,
        "windows": torque.windows,
        "duration_s": sum(end - begin for _, begin, end in diagnosis.context.laid_aside),
        "effects": _effects(diagnosis, done),
        "equations_of_motion": by_torque,
    }


def _change(
    before: float,
    after: float,
    interval: tuple[float, float],
    joints: Sequence[str],
    before_joint: np.ndarray,
    after_joint: np.ndarray,
) -> dict:
    return {
        "before": before,
        "after": after,
        "reduction": 1 - after / before if before > 0 else 0.0,
        "ci95": list(interval),
        "by_component": {
            joint: {"before": float(b), "after": float(a)} for joint, b, a in zip(joints, before_joint, after_joint)
        },
    }


def _effects(diagnosis: Diagnosis, done: Consequences) -> list[Mapping]:
    """Each effect that was chosen: what it removes of the squared residual, and of the departure in simulation."""
    joints, candidates = diagnosis.context.arm.joints, diagnosis.design.candidates
    simulated = {(e.effect, e.component): e for e in done.trial.effects} if done.trial else {}
    patched = {(e.effect, e.component) for e in done.patch.effects}
    rows = []
    for member, trial in diagnosis.held_out.effects.items():
        name = candidates[member].effect.id, candidates[member].component(joints)
        seen = simulated.get(name)
        rows.append(
            {
                "effect": name[0],
                "component": name[1],
                "is_named": member in diagnosis.chosen.members,
                "is_patched": name in patched,
                "is_judged": trial.is_shown,
                "reduction": trial.reduction,
                "ci95": list(trial.interval),
                "simulated": None
                if seen is None or not np.isfinite([seen.without, seen.with_it, *seen.interval]).all()
                else {"without": seen.without, "with": seen.with_it, "ci95": list(seen.interval), "unit": "rad"},
            }
        )
    return rows

"""Where the gap of a diagnosis is: by module and component, by stage, and by regime of motion."""

from __future__ import annotations

import numpy as np

from sim2real.checks.shrinkage import split_regimes
from sim2real.diagnosis import Diagnosis
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.stage import Stage
from sim2real.thresholds import THRESHOLDS


def locate_gap(diagnosis: Diagnosis) -> list[dict]:
    """Shares of the gap's energy above the floor by module and component; what is left is unknown."""
    if diagnosis.verdict == "no_gap":
        return []
    energy: dict[tuple[str, str], float] = {}
    for f in diagnosis.findings:
        if f.is_chosen and f.energy > 0:
            key = (ARM_EFFECTS[f.effect.id].module, f.component)
            energy[key] = energy.get(key, 0.0) + f.energy
    for j in diagnosis.unexplained:
        left = sum((r.chosen - r.flexible) / r.rows for r in diagnosis.lack_of_fit if r.joint == j)
        if left > 0:
            energy["unknown", diagnosis.context.arm.joints[j]] = left
    total = sum(energy.values())
    ranked = sorted(energy.items(), key=lambda item: -item[1])
    return [{"module": m, "component": c, "share": float(e / total)} for (m, c), e in ranked]


def stage_gaps(diagnosis: Diagnosis, joint: int) -> dict[str, dict[str, float]]:
    """RMS before and after at each stage."""
    table = {}
    for n, cell in enumerate(diagnosis.design.cells):
        if cell.joint == joint and cell.rows.any():
            after = diagnosis.gap.residuals[n]
            table[cell.name] = {
                "before": float(np.sqrt(np.mean(diagnosis.gap.nominal[n][cell.rows] ** 2))),
                "after": float(np.sqrt(np.mean(after[cell.rows] ** 2))),
            }
    return table


def regime_gaps(diagnosis: Diagnosis, joint: int) -> dict[str, dict[str, float] | None]:
    """RMS Nm of r2 before and after in each regime; None where the joint was not in it while moving."""
    samples, cells = diagnosis.context.samples, diagnosis.design.cells
    mine = [n for n, c in enumerate(cells) if c.joint == joint and c.stage is Stage.DYNAMICS]
    slide, turn = (next(n for n in mine if cells[n].at_reversal is at_reversal) for at_reversal in (False, True))
    reversing = np.zeros(samples.velocity.shape, bool)
    reversing[:, joint] = cells[turn].rows
    table = {}
    for name, mask in split_regimes(samples.velocity, samples.acceleration, reversing).items():
        n = turn if name == "reversal" else slide
        rows = mask[:, joint] & cells[n].rows
        table[name] = (
            {
                side: float(np.sqrt((values[rows] ** 2).mean()))
                for side, values in zip(("before", "after"), (diagnosis.gap.nominal[n], diagnosis.gap.residuals[n]))
            }
            if rows.any()
            else None
        )
    return table


def list_growing_gaps(diagnosis: Diagnosis) -> list[str]:
    """Joint and regime in which the gap grows by more than the threshold `shrinkage.worse`."""
    return [
        f"{joint}: {name}"
        for j, joint in enumerate(diagnosis.context.arm.joints)
        for name, rms in regime_gaps(diagnosis, j).items()
        if rms and rms["after"] > THRESHOLDS.shrinkage.worse * rms["before"]
    ]

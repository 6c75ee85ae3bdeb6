"""Every number by which the doctor decides, each with its unit and where it comes from.

`THRESHOLDS` is the one set in use; `python -m sim2real.thresholds` prints it as a table.
"""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds import camera as view
from sim2real.thresholds import checks, consequences, inference, keypoints, task

__all__ = ["THRESHOLDS", "Thresholds"]


@dataclass(frozen=True)
class Thresholds:
    """All thresholds, in the order in which a recording meets them; those of the chain beside the arm come last."""

    recordings: checks.Recordings = checks.Recordings()
    plausibility: checks.Plausibility = checks.Plausibility()
    effort: checks.Effort = checks.Effort()
    current: checks.Current = checks.Current()
    rows: inference.Rows = inference.Rows()
    hints: inference.Hints = inference.Hints()
    blocks: inference.Blocks = inference.Blocks()
    fit: inference.Fitting = inference.Fitting()
    nuisances: inference.Nuisances = inference.Nuisances()
    loop_delay: inference.LoopDelay = inference.LoopDelay()
    search: inference.Searching = inference.Searching()
    visible: inference.Visible = inference.Visible()
    ranking: inference.Ranking = inference.Ranking()
    averaging: inference.Averaging = inference.Averaging()
    estimates: inference.Estimating = inference.Estimating()
    omnibus: checks.Omnibus = checks.Omnibus()
    constancy: checks.Constancy = checks.Constancy()
    standstill: checks.Standstill = checks.Standstill()
    verdict: checks.Verdict = checks.Verdict()
    floor: checks.Floor = checks.Floor()
    shrinkage: checks.Shrinkage = checks.Shrinkage()
    ambiguity: consequences.Ambiguity = consequences.Ambiguity()
    power: consequences.Power = consequences.Power()
    simulation: consequences.Simulating = consequences.Simulating()
    patching: consequences.Patching = consequences.Patching()
    refit: consequences.Refitting = consequences.Refitting()
    track: keypoints.Tracking = keypoints.Tracking()
    scatter: keypoints.Scattering = keypoints.Scattering()
    places: view.Places = view.Places()
    view_spreads: view.ViewSpreads = view.ViewSpreads()
    view_fit: view.ViewFit = view.ViewFit()
    view_change: view.ViewChange = view.ViewChange()
    contact_force: task.ContactForce = task.ContactForce()
    touching: task.Touching = task.Touching()
    forcing: task.Forcing = task.Forcing()
    lag: task.Lagging = task.Lagging()
    meeting: task.Meeting = task.Meeting()
    tapping: task.Tapping = task.Tapping()
    motion: task.Moving = task.Moving()
    untouched: task.Untouching = task.Untouching()
    covered: task.Covering = task.Covering()
    hypotheses: task.Hypotheses = task.Hypotheses()


THRESHOLDS = Thresholds()

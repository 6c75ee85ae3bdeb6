"""Whether a patch brings the simulator nearer to a recording that it was not made from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from np_description.panda import JOINT_NAMES
from sim2real.effects.patch import Patch
from sim2real.inference.bootstrap import draw_counts
from sim2real.recordings.signals import Log
from sim2real.simulation.multiple_shooting import cut_windows, rms, simulate_departures
from sim2real.thresholds import THRESHOLDS

DRAWS = 1000


def verify_patch(logs: Sequence[Log], patch: Patch) -> dict[str, object]:
    """How far simulated shots depart from the recordings, without and with the patch.

    before, after: RMS rad, all joints together; by_joint: of each; removed: share of `before` that the patch takes
    away, removed_ci95: its 95 % interval over the windows; verdict: better, worse or same, by that interval.
    Raises ValueError for recordings without commands of the Panda, FloatingPointError for a simulation that diverges.
    """
    recorded = cut_windows(logs)
    if recorded is None:
        raise ValueError("a patch is verified in the closed loop: expected effort_command in a recording, found none")
    old, new = simulate_departures(recorded, [Patch(), patch])
    squares = np.array([np.square(errors).mean(axis=(1, 2)) for errors in (old, new)])  # of each window
    draws = draw_counts(len(recorded), DRAWS, 0)
    before, after = np.sqrt(squares.mean(axis=1))
    low, high = np.quantile(1 - np.sqrt((draws @ squares[1]) / np.maximum(draws @ squares[0], 1e-24)), (0.025, 0.975))
    by_joint = zip(JOINT_NAMES, rms(old), rms(new))
    return {
        "verdict": "better" if low > 0 else "worse" if high < 0 else "same",
        "windows": len(recorded),
        "before_rad": float(before),
        "after_rad": float(after),
        "removed": float(1 - after / max(before, 1e-12)),
        "removed_ci95": [float(low), float(high)],
        "by_joint_rad": {name: {"before": float(b), "after": float(a)} for name, b, a in by_joint},
        "held_back": patch.list_clipped_parameters(),
    }


def verification_sentence(found: dict) -> str:
    """What was found, first of all."""
    low, high = (100 * share for share in found["removed_ci95"])
    departs = f"{1e3 * found['before_rad']:.3g} mrad without it, {1e3 * found['after_rad']:.3g} mrad with it"
    share = f"{100 * found['removed']:.1f} % (95 %: {low:.1f} to {high:.1f})"
    did = {
        "better": f"The patch removes {share} of the simulator's departure from this recording",
        "worse": f"The patch takes the simulator further away: {share} of its departure removed",
        "same": f"The patch changes nothing that can be seen here: {share} of the departure removed",
    }[found["verdict"]]
    window = THRESHOLDS.simulation.window
    return f"{did}: {departs}, RMS of {found['windows']} shots of {window:g} s."


def write_verification(out: Path, found: dict) -> Path:
    """Write verification.json; its path."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "verification.json"
    path.write_text(json.dumps(found, indent=1, allow_nan=False) + "\n")
    return path

"""What others' recordings of things that slide say: a cube that is tossed onto a table, and a block on a tray that a robot carries.

`python -m np_blind.camera.slid --tosses cube_tosses.npz --tray tray_experiments.npz --out docs/results/chain_slid.json`. The last line printed is one
JSON object. Tosses tell the table's friction by themselves. The tray's block would tell the friction on the tray, if how far apart the stamps of its camera
and of its hand are were known, which is fitted: where runs of one set-up do not agree on it, nothing is said.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation
from sim2real.task.sliding import GRAVITY, Slide, friction, slides

from np_common.cli import Parser

HALF, RATE = 0.0524, 148.0  # m and 1/s, of the tossed cube as it is published
SUPPORT = 0.383 * 2 * HALF  # m: radius of the limit surface of uniform pressure
BELIEVED = 0.18  # coefficient with which the authors simulate it
GROUPS = (5, 20, 40)  # slides
STEP = 0.002  # s of the tray's replay
SMOOTH = 31, 3  # points and order, of the tray's way, whose second derivative is its acceleration
COEFFICIENTS, DELAYS = np.arange(0.2, 1.0, 0.02), np.arange(-0.1, 0.42, 0.01)  # that are tried
EXPLAINED = 0.2  # of the block's way that may be left by a replay that explains it
AGREED = 0.02, 0.1  # s, and share of the coefficient, within which runs of one set-up say the same


def tossed(tosses: Mapping[str, np.ndarray]) -> dict:
    """Friction by all free slides, by each half, and how often the interval of fewer holds what all say."""
    found: list[Slide] = []
    for name in tosses:
        row = tosses[name].astype(float)
        turned = Rotation.from_quat(row[:, [4, 5, 6, 3]]).as_matrix()
        found += slides(np.arange(len(row)) / RATE, row[:, :3] * HALF, turned, SUPPORT)
    whole = friction(found)
    groups = {}
    for size in GROUPS:
        each = [friction(found[k : k + size]) for k in range(0, len(found) - size + 1, size)]
        held = sum(one.low <= whole.mu <= one.high for one in each)
        groups[str(size)] = {
            "groups": len(each),
            "held": held,
            "half_width": float(np.median([o.high - o.mu for o in each])),
        }
    return {
        "tosses": len(tosses),
        "slides": whole.slides,
        "friction": [whole.mu, whole.low, whole.high],
        "spread": whole.spread,
        "tilt": list(whole.tilt),
        "halves": [[one.mu, one.low, one.high] for one in (friction(found[::2]), friction(found[1::2]))],
        "groups": groups,
        "named": ["table_friction"] if not whole.low <= BELIEVED <= whole.high else [],
        "relative": [value / BELIEVED - 1 for value in (whole.mu, whole.low, whole.high)],
    }


def carried(tray: Mapping[str, np.ndarray]) -> dict:
    """Of each run the coefficient and the delay of the camera that leave least of the block's way on the tray, and whether runs agree."""
    names = sorted({name.split("/")[0] for name in tray})
    runs = {name: _run(tray[f"{name}/ee_pose"].astype(float), tray[f"{name}/camera"].astype(float)) for name in names}
    delays, coefficients, left = (
        np.array([run[key] for run in runs.values()]) for key in ("delay", "friction", "left")
    )
    unexplained = int((left > EXPLAINED).sum())
    if unexplained:
        doubt = f"of {unexplained} of {len(runs)} runs no coefficient and no delay leave less than {EXPLAINED:.0%} of the block's way"
    elif np.ptp(delays) > AGREED[0]:
        doubt = f"stamps of camera and hand are {1e3 * delays.min():.0f} to {1e3 * delays.max():.0f} ms apart, another time in each run"
    elif np.ptp(coefficients) > AGREED[1] * coefficients.mean():
        doubt = f"coefficients of {coefficients.min():.2f} to {coefficients.max():.2f} explain runs of one block and one tray"
    else:
        doubt = ""
    return {"runs": runs, "verdict": "undetermined" if doubt else "told", "doubt": doubt}


def _run(hand: np.ndarray, camera: np.ndarray) -> dict:
    """hand (n, 7): s, place m, angles; camera (m, 8): s, place m and turn of the block on the tray. left: share of the way's RMS."""
    at = np.arange(hand[0, 0], hand[-1, 0], STEP)
    way = np.interp(at, hand[:, 0], hand[:, 2])
    pulls = savgol_filter(way, *SMOOTH, deriv=2, delta=STEP)
    aside = camera[:, 1:4] - np.median(camera[:8, 1:4], axis=0)
    along = aside @ np.linalg.svd(aside - aside.mean(axis=0), full_matrices=False)[2][0]
    size, best = float(np.sqrt(np.mean(along**2))), (np.inf, 0.0, 0.0)
    for coefficient in COEFFICIENTS:
        slid = replay(pulls, coefficient)
        for delay in DELAYS:
            expected = np.interp(camera[:, 0] - delay, at, slid)
            error = min(float(np.sqrt(np.mean((sign * along - expected) ** 2))) for sign in (-1, 1))
            best = min(best, (error, float(coefficient), float(delay)))
    return {"friction": best[1], "delay": best[2], "left": best[0] / size, "way": float(np.abs(along).max())}


def replay(pulls: np.ndarray, coefficient: float) -> np.ndarray:
    """m (n,) by which a block slides on a level tray with accelerations (n,) m/s^2, every STEP s; its friction is the same at rest."""
    hold, speed, place, found = coefficient * GRAVITY, 0.0, 0.0, []
    for pull in pulls.tolist():
        if speed == 0.0 and abs(pull) <= hold:
            found.append(place)
            continue
        way = np.sign(speed) if speed else -np.sign(pull)
        after = speed + (-pull - hold * way) * STEP
        speed = 0.0 if speed * after < 0 else after
        place += speed * STEP
        found.append(place)
    return np.array(found)


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(prog="python -m np_blind.camera.slid", description=__doc__.split("\n")[0])
    parser.add_argument("--tosses", type=Path, required=True, help="cube_tosses.npz")
    parser.add_argument("--tray", type=Path, required=True, help="tray_experiments.npz")
    parser.add_argument("--out", type=Path, help="file for the JSON")
    options = parser.parse_args(arguments)
    for path in (options.tosses, options.tray):
        if not path.exists():
            parser.error(f"expected a file, got {path}")
    with np.load(options.tosses) as tosses, np.load(options.tray) as tray:
        found = {
            "date": time.strftime("%Y-%m-%d"),
            "command": "python -m np_blind.camera.slid --tosses cube_tosses.npz --tray tray_experiments.npz --out docs/results/chain_slid.json",
            "tosses": tossed(tosses),
            "tray": carried(tray),
        }
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())

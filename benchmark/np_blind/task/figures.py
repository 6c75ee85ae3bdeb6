"""Figures of the chain's blind set: shares of what is right, each with its interval and its number of cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from np_blind.task.cases import CONFOUNDED, OUT
from np_common.intervals import wilson_interval

SEEN = ("camera_extrinsics", "camera_latency", "keypoint_noise", "keypoint_outliers")
"""Effects of camera and timing."""
EXACT = {"table": 0.03, "mass": 0.05, "height": 0.001, "late": 0.003, "picture_x": 0.002, "picture_y": 0.002}
"""By how much a number may be off that is met: a coefficient of friction, a share of the mass, m, s."""
MATTERS = 0.1  # share of the error of the motion that true effects remove at least, or there is nothing to remove
NO_ANSWER = {
    "module": False, "effect": False, "found": [], "named": [], "wrong": 0, "unexplained": False,
    "intervals": {}, "at_once": [], "motion": {},
}  # fmt: skip
"""Scores of a case that broke down."""
HARM = -0.05  # share removed below which a patch does harm: seen errors are known to a few per cent


def figures(rows: Sequence[Mapping]) -> dict:
    """By name: value, ci95, of. A case without a report counts as wrong, as in the arm sets."""
    ok = [row if not row.get("error") else {**row, **NO_ANSWER} for row in rows]
    kinds = {kind: [r for r in ok if r["kind"] == kind] for kind in ("clean", "single", "pair", OUT)}
    known = kinds["single"] + kinds["pair"]
    confounded = [r for r in kinds["pair"] if set(r["gap"]) == set(CONFOUNDED)]
    intervals = [
        (r, n, one) for r in ok if r["kind"] != OUT for n, one in r["intervals"].items() if n != "least_finger"
    ]
    moved = [r["motion"] for r in ok if r.get("motion") and r["motion"]["windows"]]
    asked = {
        "right module, singles": [r["module"] for r in kinds["single"]],
        "right effect or class, singles": [r["effect"] for r in kinds["single"]],
        "the same, camera and timing": [r["effect"] for r in kinds["single"] if set(r["gap"]) & set(SEEN)],
        "pairs, both and nothing else": [r["effect"] for r in kinds["pair"]],
        "pairs, effects found": [effect in r["found"] for r in kinds["pair"] for effect in r["gap"]],
        "confounded pair, both or their class": [r["effect"] for r in confounded],
        "something wrong named, of all known": [bool(r["wrong"]) for r in known],
        "false alarm, clean": [bool(r["named"] or r["unexplained"] or r.get("error")) for r in kinds["clean"]],
        "out of catalogue: unexplained": [r["unexplained"] for r in kinds[OUT]],
        "out of catalogue: named something": [bool(r["named"]) and not r["unexplained"] for r in kinds[OUT]],
        "95 % intervals that hold": [one["holds"] for _, _, one in intervals],
        **_check_errors(intervals),
        "patch does harm to held-out motion": [1 - m["patch"] / m["believed"] < HARM for m in moved],
        "patch surely does harm to it": [m["removed"][2] < 0 for m in moved],
        "the true effects do harm to it": [1 - m["truth"] / m["believed"] < HARM for m in moved],
        "everything at once: false alarm, clean": [bool(r["at_once"] or r.get("error")) for r in kinds["clean"]],
        "everything at once: right effects, singles": [_is_right(r) for r in kinds["single"]],
        "everything at once does harm": [1 - m["at_once"] / m["believed"] < HARM for m in moved],
        "errors": [bool(row.get("error")) for row in rows],
    }
    return rates(asked) | _removed([r["motion"] for r in known if r.get("motion") and r["motion"]["windows"]])


def rates(asked: Mapping[str, Sequence[bool]]) -> dict[str, dict]:
    """By name, value, ci95, of: the share of what is true, of those that there are."""
    return {
        name: {"value": sum(of) / len(of), "ci95": list(wilson_interval(sum(of), len(of))), "of": len(of)}
        for name, of in asked.items()
        if of
    }


def _check_errors(intervals: Sequence[tuple[Mapping, str, Mapping]]) -> dict[str, list[bool]]:
    """By number, whether each is within `EXACT` of the truth."""
    found: dict[str, list[bool]] = {}
    for _, name, one in intervals:
        if name in EXACT:
            scale = one["true"] if name == "mass" else 1.0
            label = "picture" if name.startswith("picture") else name
            found.setdefault(f"{label} within {_bound(name)}", []).append(
                abs(one["value"] - one["true"]) < EXACT[name] * scale
            )
    return found


def _bound(name: str) -> str:
    return {"table": ".03", "mass": "5 %", "height": "1 mm", "late": "3 ms"}.get(name, "2 mm")


def _is_right(row: Mapping) -> bool:
    """Whether a baseline names the true effects and no other."""
    return set(row["at_once"]) == set(row["gap"])


def _removed(moved: Sequence[Mapping]) -> dict:
    """Held-out motion: share of what the true effects remove, by the patch and by everything at once."""
    label = "held-out motion of the object: share of what the true effects remove"
    found = {label: share_of_true(moved, "patch"), f"{label}, everything at once": share_of_true(moved, "at_once")}
    return {name: share for name, share in found.items() if share}


def share_of_true(moved: Sequence[Mapping], name: str) -> dict | None:
    """value, ci95, of: share of the error of the motion that true effects remove that is gone with `name` too, of cases in which they remove enough
    to measure; errors of all of them together, with an interval by the bootstrap over cases. None without such cases."""
    worth = [m for m in moved if m["believed"] - m["truth"] > MATTERS * m["believed"]]
    if not worth:
        return None
    believed, truth = (np.array([m[one] for m in worth]) for one in ("believed", "truth"))
    drawn = np.random.default_rng(0).integers(len(worth), size=(2000, len(worth)))
    gone = believed - np.array([m[name] for m in worth])
    shares = gone[drawn].sum(axis=1) / (believed - truth)[drawn].sum(axis=1)
    return {
        "value": float(gone.sum() / (believed - truth).sum()),
        "ci95": np.quantile(shares, [0.025, 0.975]).tolist(),
        "of": len(worth),
    }

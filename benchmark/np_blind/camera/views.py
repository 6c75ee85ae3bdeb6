"""How well the view stage tells what is off: boxes at rest, made by a camera of its own, with one thing off, none, or what it has no word for.

`python -m np_blind.camera.views --draws 40 --seed 0 --out views.json`: as many draws of each kind. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from sim2real.task.camera.parameters import EFFECTS, NAMES

from np_blind.camera.boxes import DEGREE, Case, Detector, Truth, places, usual
from np_common.cli import Parser, Progress
from np_description.domains import BUMP, CARD

if TYPE_CHECKING:
    from sim2real.task.camera.diagnosis import CameraDiagnosis

LIMITS = {
    "camera_place": ("camera", 3, 0.002),
    "camera_turn": ("turn", 3, 0.2 * DEGREE),
    "focal_length": ("focal", 1, 0.004),
    "image_offset": ("offset", 2, 0.7),
    "distortion": ("k1", 1, 0.044),
    "table_height": ("height", 1, 0.001),
    "table_tilt": ("tilt", 2, 0.1 * DEGREE),
    "object_size": ("size", 3, 0.001),
}
"""By effect: its field of `Truth`, how many numbers that has, and the declared limit. Cases are 3 to 8 times that."""
THINNER = 0.4  # of an edge that a gap of it is at most
Draw = Callable[[np.random.Generator], tuple[Truth, dict]]


def single(effect: str, rng: np.random.Generator) -> Truth:
    """An effect of 3 to 8 times its limit, in any direction."""
    field, count, limit = LIMITS[effect]
    way = rng.standard_normal(count)
    way *= rng.uniform(3, 8) * limit / np.linalg.norm(way)
    return Truth(**{field: tuple(way.tolist()) if count > 1 else float(way[0])})


def pair(rng: np.random.Generator) -> Truth:
    """Two effects."""
    one, other = rng.choice(list(LIMITS), 2, replace=False)
    return single(one, rng) + single(other, rng)


KINDS: dict[str, Draw] = {
    "clean": lambda rng: (Truth(), {}),
    **{effect: lambda rng, effect=effect: (single(effect, rng), {}) for effect in LIMITS},
    "pair": lambda rng: (pair(rng), {}),
    "moved": lambda rng: (Truth(), {"moved": (int(rng.integers(3, 6)), single("camera_turn", rng))}),
    "dented": lambda rng: (Truth(), {"dent": rng.uniform(0.006, 0.015)}),
    "wild": lambda rng: (Truth(), {"own": rng.uniform(4, 6)}),
}
UNKNOWN = ("moved", "dented", "wild")
"""What the stage has no word for: unexplained, at best."""


def row(kind: str, seed: int, number: int, measured: bool) -> dict:
    """One case: what was true, and what was found."""
    from sim2real.task.camera.diagnosis import diagnose_camera  # slow: no --help should wait for it

    rng = np.random.default_rng([seed, number, list(KINDS).index(kind), measured])
    gap, more = KINDS[kind](rng)
    own = more.pop("own", rng.uniform(0.2, 0.8))
    detector = Detector(own=own, **({} if measured else {"measured": None}))
    domain = (CARD, BUMP)[number % 2]
    most = THINNER * 2 * np.asarray(domain.half_size)
    gap = replace(gap, size=tuple(np.clip(gap.size, -most, most).tolist()))
    case = Case(gap + usual(rng), detector, domain, int(rng.integers(6, 12)), **more)
    made = places(case, rng)
    begun = time.perf_counter()
    found = diagnose_camera(made)
    return {
        "kind": kind,
        "measured": measured,
        "verdict": found.verdict,
        "seconds": time.perf_counter() - begun,
        **_judged(kind, gap, case.truth, found),
    }


def _judged(kind: str, gap: Truth, truth: Truth, found: CameraDiagnosis) -> dict:
    ids = {effect: set(EFFECTS[effect].ids) for effect in EFFECTS}
    named = [{way.name for way in one.hypotheses} for one in found.findings]
    true = {e for e, (field, _, _) in LIMITS.items() if np.any(np.asarray(getattr(gap, field)))}
    values = dict(zip(NAMES, truth.numbers))
    told = [(way.name, way.estimates) for one in found.findings for way in one.hypotheses]
    is_said = found.verdict in ("identified", "ambiguous")
    sizes = {k: v for effect, own in told if is_said and effect in true for k, v in own.items()}
    right = [any(ids[t] & ids[e] for cls in named for e in cls) for t in true]
    return {
        "named": [sorted(cls) for cls in named],
        "covered": bool(right) and all(right),
        "wrong": sum(not any(ids[t] & ids[e] for t in true for e in cls) for cls in named),
        "held": sum(bool(v.low <= values[k] <= v.high) for k, v in sizes.items()),
        "sizes": len(sizes),
        "held_bounds": sum(bool(v.low <= values[k] <= v.high) for k, v in found.bounds.items()),
        "bounds": len(found.bounds),
        "doubt": found.abstention_reason,
    }


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(prog="python -m np_blind.camera.views", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--draws", type=int, default=40, help="of each kind, with a measured pose and without (default 40)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file for the JSON, with a row for each case")
    options = parser.parse_args(arguments)
    every = [(k, n, m) for m in (True, False) for k in KINDS for n in range(options.draws)]
    progress, rows = Progress(max(len(every), 1), "views"), []
    for done, (kind, number, measured) in enumerate(every):
        progress.show(done, kind)
        rows.append(row(kind, options.seed, number, measured))
    progress.show(len(every), "done")
    found = {"draws": options.draws, "seed": options.seed, "figures": [_figures(rows, m) for m in (True, False)]}
    for figures in found["figures"]:
        print(_table(figures), file=sys.stderr)
    if options.out:
        options.out.write_text(json.dumps({**found, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found))
    return 0


def _figures(rows: list[dict], measured: bool) -> dict:
    mine = [r for r in rows if r["measured"] == measured]

    def share(of: list[dict], key: Callable[[dict], bool]) -> float | None:
        return float(np.mean([key(r) for r in of])) if of else None

    kinds = {}
    for kind in KINDS:
        of = [r for r in mine if r["kind"] == kind]
        kinds[kind] = {v: share(of, lambda r: r["verdict"] == v) for v in ("no_gap", "undetermined", "unexplained")}
        kinds[kind] |= {
            "right": share(
                of, lambda r: r["covered"] and not r["wrong"] and r["verdict"] in ("identified", "ambiguous")
            ),
            "wrong": share(of, lambda r: r["wrong"] > 0 and r["verdict"] in ("identified", "ambiguous")),
        }
    pairs = [r for r in mine if r["kind"] == "pair"]
    known = [r for r in mine if r["kind"] in LIMITS]
    clean = [r for r in mine if r["kind"] == "clean"]
    sizes, bounds = sum(r["sizes"] for r in known), sum(r["bounds"] for r in clean)
    return {
        "measured": measured,
        "kinds": kinds,
        "sizes_hold": sum(r["held"] for r in known) / max(sizes, 1),
        "sizes": sizes,
        "sizes_of_pairs_hold": sum(r["held"] for r in pairs) / max(sum(r["sizes"] for r in pairs), 1),
        "sizes_of_pairs": sum(r["sizes"] for r in pairs),
        "bounds_hold": sum(r["held_bounds"] for r in clean) / max(bounds, 1),
        "bounds": bounds,
        "seconds": float(np.median([r["seconds"] for r in mine])),
    }


def _table(figures: dict) -> str:
    lines = [
        f"pose measured: {figures['measured']}; of named sizes {figures['sizes_hold']:.3f} of {figures['sizes']} hold; of all "
        f"numbers of clean cases {figures['bounds_hold']:.3f} of {figures['bounds']}; {figures['seconds']:.2f} s a case"
    ]
    for kind, shares in figures["kinds"].items():
        lines.append(f"  {kind:14s} " + "  ".join(f"{name} {value:.2f}" for name, value in shares.items()))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

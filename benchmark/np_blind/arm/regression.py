"""`regression FORMER NOW [FORMER NOW ...]`: the same cases of sealed sets by two versions, figure by figure.

Each is the results.json of `blind`, and every two are of one key. Figures are of the cases that both have. The cases are the
same, so that chance lies only in those that one version has right and the other wrong. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from np_blind.arm.evaluation.scoring import Score, median
from np_common.cli import Parser
from np_common.intervals import wilson_interval

NORMAL95 = 1.96  # standard deviations
# Key of a figure, what it means, its values for a case, whether more is better.
FIGURES: tuple[tuple[str, str, Callable[[Score], Sequence[bool | None]], bool], ...] = (
    ("module", "right module", lambda s: [s.module], True),
    ("joint", "right joint", lambda s: [s.joint], True),
    ("effect", "right effect or class, 3 x limit", lambda s: [s.effect], True),
    ("false_alarm", "false alarm, clean arms", lambda s: [s.false_alarm], False),
    ("abstained", "says unexplained, out of catalogue", lambda s: [s.abstained], True),
    ("pair", "pairs, both among the first three", lambda s: [s.pair], True),
    ("covered", "95 % intervals that hold the truth", lambda s: s.covered, True),
    ("harm", "patch makes it worse", lambda s: [s.harm], False),
)


def compare_paired(former: Sequence[bool], now: Sequence[bool]) -> tuple[float, tuple[float, float]]:
    """(difference, its 95 % interval) of two rates of the same n > 0 cases (Agresti and Min, Statistics in Medicine 2005)."""
    gained, lost = (sum(a and not b for a, b in zip(*two)) for two in ((now, former), (former, now)))
    count, difference = len(now) + 2, gained - lost
    error = NORMAL95 * (gained + lost + 1 - difference**2 / count) ** 0.5
    return difference / len(now), (max(-1.0, (difference - error) / count), min(1.0, (difference + error) / count))


def compare_unpaired(former: Sequence[bool], now: Sequence[bool]) -> tuple[float, tuple[float, float]]:
    """The same of unpaired results (Newcombe, Statistics in Medicine 1998, method 10)."""
    (a, low, high), (b, least, most) = ((sum(x) / len(x), *wilson_interval(sum(x), len(x))) for x in (former, now))
    under, over = ((b - least) ** 2 + (high - a) ** 2) ** 0.5, ((most - b) ** 2 + (a - low) ** 2) ** 0.5
    return b - a, (b - a - under, b - a + over)


def compare(former: Iterable[Score], now: Iterable[Score]) -> list[dict]:
    """Rows of the figures that the cases of both have. gained, lost: cases that only one of them has right."""
    before, after = ({s.case: s for s in scores} for scores in (former, now))
    both = sorted(set(before) & set(after))
    rows = []
    for key, text, answers, more_is_better in FIGURES:
        is_paired = key != "covered"  # which parameters have an interval depends on what is named
        kept = [n for n in both if not is_paired or None not in (*answers(before[n]), *answers(after[n]))]
        one, other = ([bool(x) for n in kept for x in answers(scores[n])] for scores in (before, after))
        if not one or not other:
            continue
        difference, ci95 = (compare_paired if is_paired else compare_unpaired)(one, other)
        right = [[x is more_is_better for x in values] for values in (one, other)]
        rows.append(
            {
                "figure": key,
                "says": text,
                "answers": [len(one), len(other)],
                "former": round(sum(one) / len(one), 4),
                "former_ci95": [round(x, 4) for x in wilson_interval(sum(one), len(one))],
                "now": round(sum(other) / len(other), 4),
                "gained": [n for n, a, b in zip(kept, *right) if b and not a] if is_paired else [],
                "lost": [n for n, a, b in zip(kept, *right) if a and not b] if is_paired else [],
                "difference": round(difference, 4),
                "difference_ci95": [round(x, 4) for x in ci95],
                "is_worse": bool(ci95[1] < 0 if more_is_better else ci95[0] > 0),
            }
        )
    return rows


def together(pairs: Sequence[tuple[Sequence[Score], Sequence[Score]]]) -> tuple[list[Score], list[Score]]:
    """All sets as one, cases numbered on: a thousand a set."""
    return tuple(
        [replace(s, case=1000 * number + s.case) for number, pair in enumerate(pairs) for s in pair[side]]
        for side in (0, 1)
    )


def _read(path: Path) -> tuple[dict, list[Score]]:
    data = json.loads(path.read_text(encoding="utf-8"))
    return data["figures"], [Score(**case) for case in data["cases"]]


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(prog="python -m np_blind.arm.regression", description=__doc__.split("\n")[0])
    parser.add_argument(
        "results", nargs="+", type=Path, metavar="FORMER NOW", help="results.json of one key, two by two"
    )
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    options = parser.parse_args(arguments)
    read = [_read(path) for path in options.results]
    if len(read) % 2:
        parser.error("expected results two by two, FORMER NOW")
    sets, pairs = [], []
    for (old, former), (new, now) in zip(read[::2], read[1::2]):
        if old["key_sha256"] != new["key_sha256"]:
            parser.error(f"expected results of one key, got {old['key_sha256'][:12]} and {new['key_sha256'][:12]}")
        seen = {s.case for s in now} & {s.case for s in former}
        shares = [median([s.share for s in scores if s.case in seen]) for scores in (former, now)]
        sets.append(
            {
                "set": new.get("set", "locked"),
                "seed": new["seed"],
                "cases": sorted(seen),
                "codes": [old.get("diagnosis_sha256"), new["diagnosis_sha256"]],
                "share_of_true_faults": shares,
                "errors": [sum(bool(s.error) for s in scores if s.case in seen) for scores in (former, now)],
                "figures": compare(former, now),
            }
        )
        pairs.append((former, now))
    data = {"sets": sets, "together": compare(*together(pairs))}
    options.out.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    worse = [f"{s['seed']}: {row['says']}" for s in sets for row in s["figures"] if row["is_worse"]]
    print(
        json.dumps(
            {"sets": len(sets), "cases": sum(len(s["cases"]) for s in sets), "worse": worse, "out": str(options.out)}
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

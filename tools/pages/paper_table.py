"""The paper's Table III, played through the graph and printed beside the paper's own successes."""

from __future__ import annotations

from collections.abc import Mapping

from np_evaluation.paper_table import OURS, TITLES
from pages.markdown import rate, table

LISTED = 100  # failures, at most


def tabled(data: Mapping) -> tuple[str, str]:
    """Headline and body of a table of objects."""
    total = data["totals"]["ours"]
    again = "first_contact" in total
    rows = [
        (
            row["domain"],
            _played_by(row),
            *(_cell(row["scenarios"].get(str(n), (0, 0))) for n in (1, 2, 3)),
            rate(row["success"], row["ci95"]) if row["episodes"] else "not played",
            *([_first(row)] if again else []),
            _paper(row),
            ", ".join(f"{phase}: {count}" for phase, count in row["failures"].items()),
        )
        for row in data["rows"]
    ]
    first = ["of these with the first contact"] if again else []
    head = (
        "domain",
        "object",
        "scenario 1",
        "2",
        "3",
        "success, 95 % Wilson interval",
        *first,
        "the paper's",
        "failed in",
    )
    body = table(head, rows)
    body += "\n## Together\n\n" + table(
        (
            "rows of",
            "episodes",
            "success, 95 % Wilson interval",
            *first,
            "of these not declared",
            "the paper's of the same rows",
        ),
        (
            (
                _whose(name),
                one["episodes"],
                rate(one["success"], one["ci95"]),
                *([_first(one)] if again else []),
                one["missed"],
                _papers(data["rows"], *name.split(" ")),
            )
            for name, one in data["totals"].items()
        ),
    )
    if total["reasons"]:
        body += "\n## What failed\n\n" + table(
            ("what the graph said (# for a number)", "episodes"), total["reasons"].items()
        )
        failed = [e for e in data["per_episode"] if not e["success"]]
        if len(failed) > LISTED:
            body += f"\nThe first {LISTED} of them; all are in the data.\n"
        body += "\n" + table(
            (
                "domain",
                "object",
                "scenario",
                "episode",
                "contacts",
                "reason",
                "distance, mm",
                "angle, rad",
                "simulated, s",
            ),
            (
                (
                    e["domain"],
                    _played_by(e),
                    e["scenario"],
                    e["episode"],
                    e["contacts"],
                    e["reason"],
                    None if e["distance"] is None else 1e3 * e["distance"],
                    e["angle"],
                    e["duration"],
                )
                for e in failed[:LISTED]
            ),
        )
    graph = "" if data.get("graph", True) else " (`--without-graph`)"
    body += f"\nEngine {data['engine']}, keypoints: {data['keypoints']}{graph}, revision `{data['revision']}`, {data['wall_s']:.0f} s.\n"
    return f"{total['successes']} of {total['episodes']} ({total['ci95'][0]:.2f} to {total['ci95'][1]:.2f})", body


def _played_by(row: Mapping) -> str:
    return f"`{row['object']}`" + (f", {TITLES[row['method']]}" if row["method"] != OURS else "")


def _whose(name: str) -> str:
    """What a total called "ours", "ours bump", "osc" ... is of."""
    method, *domain = name.split(" ")
    return ", ".join([*(domain or ["all"]), *([TITLES[method]] if method != OURS else [])])


def _cell(counted: tuple[int, int]) -> str:
    return "{} of {}".format(*counted) if counted[1] else ""


def _first(figures: Mapping) -> str:
    return rate(*figures.get("first_contact", {name: figures[name] for name in ("success", "ci95")}).values())


def _paper(row: Mapping) -> str:
    return "" if row["paper_successes"] is None else f"{row['paper_successes']} of {row['paper_tries']}"


def _papers(rows: list[Mapping], method: str, domain: str = "") -> str:
    mine = [
        r
        for r in rows
        if r["method"] == method and domain in ("", r["domain"]) and r["episodes"] and r["paper_successes"] is not None
    ]
    if not mine:
        return ""
    successes, tries = (sum(r[f"paper_{name}"] for r in mine) for name in ("successes", "tries"))
    return f"{successes} of {tries} ({successes / tries:.2f})"

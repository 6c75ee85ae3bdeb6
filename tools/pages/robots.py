"""Results of the withheld robots: what was found, what it cost, what came back; and policies of other days on all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import yaml

from pages.markdown import table


def robots(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.robots.set`."""
    rows, found = data["rows"], data["figures"]
    headline = f"{len(rows)} of {data['drawn']} robots: " + ", ".join(
        f"{name} {found[name]['value']:.2f} of {found[name]['of']}"
        for name in ("top cause named", "lost success that returns, median", "worse than before")
        if found[name]["value"] is not None
    )
    body = table(
        ("figure", "value", "95 %", "of", "each"),
        (
            (
                name,
                one["value"],
                _interval(one.get("ci95")),
                one["of"],
                ", ".join(f"{value:.2f}" for value in one.get("each", ())) or None,
            )
            for name, one in found.items()
        ),
    )
    trained = (
        f"{data['minutes']:g} minutes of training on one of {data['gpus']} GPUs" if data["gpus"] else "nothing trained"
    )
    body += f"\n{data['episodes']} episodes a figure, {trained}, {data['wall_s']:.0f} s in all."
    body += f" SHA-256 of the key `{data['key_sha256'][:16]}`, of the doctor `{data['doctor_sha256'][:16]}`.\n\n## Every robot\n\n"
    body += "Success in PhysX; in brackets what the simulator predicts, with the patch where there is one.\n\n"
    head = (
        "robot",
        "what is other",
        "found",
        "blamed",
        "nominal",
        "before",
        "corrected",
        "trained",
        "kept",
        "oracle",
        "",
    )
    return headline, body + table(head, (_robot(row) for row in rows))


def _robot(row: Mapping) -> tuple:
    engine, predicted = row.get("engine", {}), row.get("success", {})
    kept = row.get("kept") or ("trained" if row.get("adopted") else "before")
    of_kept = {"before": "patched", "corrected": "patched_corrected", "trained": "patched_after"}[kept]
    cause = row.get("cause")
    note = row["error"].strip().splitlines()[-1] if row.get("error") else ""
    return (
        f"{row['robot']} {row['domain']}",
        _patch(row["truth"]),
        _patch(row["found"]) if "found" in row else None,
        cause.replace("_", " ") if cause else ("nothing" if "costs" in row else None),
        _success(engine.get("nominal"), predicted.get("nominal")),
        _success(engine.get("before"), predicted.get("patched")),
        _success(engine.get("corrected"), predicted.get("patched_corrected")),
        _success(engine.get("after"), predicted.get("patched_after")),
        _success(engine.get("adopted"), predicted.get(of_kept)),
        _success(engine.get("oracle"), None),
        note or {"before": "as it was", "corrected": "corrected, old policies"}.get(kept, ""),
    )


def _patch(text: str) -> str:
    effects = yaml.safe_load(text)["effects"]
    said = (
        f"{e['effect'].replace('_', ' ')}"
        + (f" {e['component']}" if e["component"].startswith("panda") else "")
        + " "
        + ", ".join(f"{name} {value:.3g}" for name, value in e["parameters"].items() if value)
        for e in effects
    )
    return "; ".join(said) or "nothing"


def _interval(both: Sequence[float] | None) -> str | None:
    return "{:.2f} to {:.2f}".format(*both) if both else None


def _success(each: Sequence[int] | None, predicted: Mapping | None) -> str | None:
    if each is None:
        return None
    said = f" ({predicted['value']:.2f})" if predicted else ""
    return f"{sum(each) / len(each):.2f}{said}"


SIMULATORS = {
    "patched": "patched",
    "patched_score": "patched, by score",
    "nominal": "nominal",
    "exact": "*one with reality's own rates, by so many episodes*",
}


def matrix(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.robots.matrix`."""
    found = data["figures"]
    headline = "; ".join(
        f"{side}: r {found[side]['r']:.2f}, MMRV {found[side]['mmrv']:.3f}"
        for side in ("patched", "nominal")
        if found[side]["r"] is not None
    )
    body = table(
        ("simulator", "r", "95 %", "MMRV", "95 %", "mean error"),
        (
            (
                SIMULATORS[side],
                found[side]["r"],
                _interval(found[side].get("r_ci95")),
                found[side]["mmrv"],
                _interval(found[side].get("mmrv_ci95")),
                found[side]["mean_absolute_error"],
            )
            for side in SIMULATORS
            if side in found
        ),
    )
    body += f"\n{data['episodes']} episodes a cell, {found['cells']} pairs of robot and policy.\n\n## Every cell\n\n"
    head = ("robot", "policy", "nominal simulator", "patched simulator", "PhysX")
    rows = (
        (f"{r['robot']} {r['domain']}", r["policy"].replace("_", " "), r["nominal"], r["patched"], r["engine"])
        for r in data["table"]
    )
    return headline, body + table(head, rows)

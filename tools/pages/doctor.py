"""Results of the gap doctor: sealed sets, a clean arm; and identification, its peer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from np_blind.arm.judged.scoring import Score
from np_blind.arm.judged.tables import failures_table, figures_table
from pages.markdown import rate, table

EVERY = "all together"
# Of a sealed set; a set of changes has neither strangers nor a held-out gap, but its false alarms are half of the question.
HEADLINE = (
    ("module", "module_accuracy"),
    ("effect", "effect_class_accuracy"),
    ("false alarm", "false_alarm"),
    ("strangers", "abstain_out_of_catalogue"),
    ("harm", "harm"),
)


def sealed(data: Mapping) -> tuple[str, str]:
    """Headline and body of a sealed set: figures beside their goals, effects, every failure."""
    figures, scores = data["figures"], [Score(**case) for case in data["cases"]]
    asked = {name: figures[key] for name, key in HEADLINE if figures[key] is not None}
    headline = ", ".join(f"{name} {value:.3f}" for name, value in asked.items())
    body = figures_table(figures, scores) + "\n## Failures\n\n" + failures_table(scores)
    if "doctor_sha256" in figures:
        body += f"\nKey `{figures['key_sha256']}`, doctor `{figures['doctor_sha256']}` (SHA-256).\n"
    return headline, body


def regression(data: Mapping) -> tuple[str, str]:
    """Headline and body of sealed sets that another doctor has answered again."""
    every = [row for one in data["sets"] for row in one["figures"]]
    worse = [row for row in every if row["is_worse"]]
    headline = (
        f"{sum(len(one['cases']) for one in data['sets'])} cases again, {len(worse)} of {len(every)} figures worse"
    )
    header = ("set", "figure", "answers", "then", "now", "difference", "right only now", "right only then", "")
    groups = [(f"{one['set']} {one['seed']}", one["figures"]) for one in data["sets"]]
    rows = [
        (
            name,
            row["says"],
            " and ".join(map(str, sorted(set(row["answers"]), key=row["answers"].index))),
            rate(row["former"], row["former_ci95"]),
            f"{row['now']:.3f}",
            "{:+.3f} ({:+.3f} to {:+.3f})".format(row["difference"], *row["difference_ci95"]),
            _cases(row["gained"]) if name != EVERY else len(row["gained"]),
            _cases(row["lost"]) if name != EVERY else len(row["lost"]),
            "worse" if row["is_worse"] else "",
        )
        for name, figures in (*groups, (EVERY, data["together"]))
        for row in figures
    ]
    sets = [
        (
            name,
            len(one["cases"]),
            *(value and f"{value:.3f}" for value in one["share_of_true_faults"]),
            *one["errors"],
            *(doctor and f"`{doctor[:12]}`" for doctor in one["doctors"]),
        )
        for (name, _), one in zip(groups, data["sets"])
    ]
    about = (
        "set",
        "cases",
        "share of what the true faults remove, then",
        "now",
        "errors then",
        "now",
        "doctor then",
        "now",
    )
    return headline, table(header, rows) + "\n" + table(about, sets)


def _cases(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def clean_arm(data: Mapping) -> tuple[str, str]:
    """Headline and body of a recording without effects."""
    gap = data["gap"]
    body = f"{data['what']}.\n\n```\n" + "\n".join(data["commands"]) + "\n```\n\n"
    rows = [
        ("verdict", f"`{data['verdict']}`"),
        (gap["metric"], f"{gap['before']:.4f} {gap['unit']}"),
        ("recording", f"{data['duration_s']:.0f} s"),
        ("run time", f"{data['runtime_s']:.0f} s"),
    ]
    return data["verdict"], body + table(("figure", "value"), rows)


def identified(data: Mapping) -> tuple[str, str]:
    """Headline and body of the identification methods on one recording."""
    rows = [
        (f"`{name}`", 1e3 * m["gap_before_rad"], 1e3 * m["gap_after_rad"], m["steps"], m["wall_s"])
        for name, m in data["methods"].items()
    ]
    header = ("method", "held-out error before, mrad", "after, mrad", "physics steps", "s")
    body = f"`python -m np_blind.baselines.identify {' '.join(data['command'])}`\n\n" + table(header, rows)
    headline = ", ".join(f"{name} {1e3 * m['gap_after_rad']:.3g} mrad" for name, m in data["methods"].items())
    return headline, body + (f"\n{data['note']}\n" if data.get("note") else "")


def delays(data: Mapping) -> tuple[str, str]:
    """Headline and body of identification under assumed delays."""
    rows = [
        (delay, fit["fit_rmse_mrad"], *(", ".join(f"{v:g}" for v in fit[key]) for key in KEYS))
        for delay, fit in data["by_delay_ms"].items()
    ]
    header = ("delay, ms", "fit, mrad", "friction, Nm", "damping, Nms/rad", "armature, kg m^2")
    return f"{len(rows)} delays", f"{data['what']}.\n\n`{data['command']}`\n\n" + table(header, rows)


KEYS = ("frictionloss", "damping", "armature")

"""The results of the blind test for people: tables in Markdown, and one figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from np_blind.arm.evaluation.scoring import CLEAR, Score, by_effect, median
from np_blind.arm.sampling.cases import CHANGES

# Key of the summary, what it means, its goal (least, or greatest where the sign is <=).
GOALS = (
    ("module_accuracy", "right module", ">= .97"),
    ("joint_accuracy", "right joint", ">= .95"),
    ("effect_class_accuracy", f"right effect or class, {CLEAR:g} x limit", ">= .90"),
    ("false_alarm", "false alarm, clean arms", "<= .05"),
    ("abstain_out_of_catalogue", "says unexplained, out of catalogue", ">= .90"),
    ("pairs_top3", "pairs, both among the first three", ">= .85"),
    ("settled_by_next", "ambiguous, settled by the one suggested experiment", ">= .60"),
    ("settled_where_known", "the same, where the truth was among what it was to tell apart", ""),
    ("coverage95", "95 % intervals that hold the truth", ".92 to .98"),
    ("harm", "patch makes it worse", "<= .02"),
)

# Of sets of changes.
GOALS_OF_CHANGES = (
    ("effect_class_accuracy", f"right effect or class, {CLEAR:g} x limit", ">= .95"),
    ("effect_class_accuracy_any", "right effect or class, all sizes", ">= .95"),
    ("module_accuracy", "right module", ""),
    ("joint_accuracy", "right joint", ""),
    ("false_alarm", "false alarm, nothing changed", "<= .05"),
    ("coverage95", "95 % intervals that hold the change", ">= .92"),
)

SHRINKS = (
    ("shrink_vs_oracle", ", share of what the true faults remove", ">= .90"),
    ("shrink_absolute", "", ">= .80"),
)


def goals_of(figures: Mapping) -> tuple[tuple[str, str, str], ...]:
    """The questions of a set: key of the summary, what it means, its goal."""
    return GOALS_OF_CHANGES if figures.get("set") in CHANGES else GOALS


def _known(figures: Mapping) -> list[tuple[str, str, str]]:
    """The questions of a set that its figures cover: not those added since."""
    return [row for row in goals_of(figures) if row[0] in figures]


def figures_table(figures: Mapping, scores: Sequence[Score]) -> str:
    """Figures beside their goals, then what was right of each effect; first of all how many cases they are of."""
    drawn = figures.get("drawn", figures["cases"])
    part = "" if figures["cases"] == drawn else " (the others have not been run: preliminary)"
    lines = [
        f"{figures['cases']} of {drawn} cases{part}.",
        "",
        "| figure | value | 95 % | cases | goal |",
        "|---|---|---|---|---|",
    ]
    for key, text, goal in _known(figures):
        low, high = figures[f"{key}_ci95"]
        lines.append(f"| {text} | {_number(figures[key])} | {low:.3f} to {high:.3f} | {figures[f'{key}_n']} | {goal} |")
    for key, text, goal in SHRINKS if goals_of(figures) is GOALS else ():
        lines.append(
            f"| held-out gap removed{text}, median | {_number(figures[key])} | | "
            f"{figures['shrink_vs_oracle_n']} | {goal} |"
        )
    if goals_of(figures) is GOALS:
        possible = median([s.possible for s in scores])
        lines.append(
            f"| held-out gap that the true faults remove, median: what a patch can | {_number(possible)} | | | |"
        )
    lines += _beside(figures)
    header = "| effect | cases | module | joint | clear | named | unexplained | intervals that hold |"
    lines += ["", header, "|---" * 8 + "|"]
    for name, row in by_effect(scores).items():
        held = f"{row['held']} of {row['intervals']}" if row["intervals"] else ""
        lines.append(
            f"| {name} | {row['cases']} | {row['module']} | {row['joint']} | {row['clear']} | "
            f"{row['named_when_clear']} | {row['abstained']} | {held} |"
        )
    return "\n".join(lines) + "\n"


def _beside(figures: Mapping) -> list[str]:
    """The baselines of the same run beside the diagnosis."""
    others = {name: own for name, own in figures.get("baselines", {}).items() if isinstance(own, Mapping)}
    if not others:
        return []
    rows = [(key, text) for key, text, _ in GOALS if key in next(iter(others.values()))]
    rows += [
        ("shrink_vs_oracle", "held-out gap removed, share of what the true faults remove, median"),
        ("shrink_absolute", "held-out gap removed, median"),
        ("wall_s_a_case", "s a case"),
    ]
    diagnosis = {**figures, "wall_s_a_case": figures["runtime_median_s"]}
    lines = ["", f"| figure | diagnosis | {' | '.join(others)} |", "|---" * (len(others) + 2) + "|"]
    for key, text in rows:
        lines.append(f"| {text} | {' | '.join(_number(own[key]) for own in (diagnosis, *others.values()))} |")
    return lines


def failures_table(scores: Sequence[Score]) -> str:
    """Every case with anything wrong."""
    lines = ["| case | kind | truth | size | verdict | named | wrong |", "|---|---|---|---|---|---|---|"]
    for s in scores:
        if s.is_failure:
            wrong = [name for name in ("module", "joint", "effect", "abstained", "pair") if getattr(s, name) is False]
            wrong += ["false alarm"] * bool(s.false_alarm) + ["harm"] * bool(s.harm)
            wrong += [s.error.splitlines()[0][:80].replace("|", "/")] if s.error else []
            lines.append(
                f"| {s.case} | {s.kind} | {', '.join(s.truth)} | {s.size:.1f} | {s.verdict} | "
                f"{', '.join(s.named)} | {', '.join(wrong)} |"
            )
    return "\n".join(lines) + "\n"


def plot(figures: Mapping, scores: Sequence[Score], path: Path) -> None:
    """Rates with their intervals and goals; and what is named against the size of the effect."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), width_ratios=[3, 2], layout="constrained")
    shown = [row for row in _known(figures) if figures[row[0]] is not None]
    for y, (key, _, goal) in enumerate(reversed(shown)):
        low, high = figures[f"{key}_ci95"]
        left.plot([low, high], [y, y], color="0.5", lw=3, solid_capstyle="butt")
        left.plot(figures[key], y, "o", color="C0")
        for bound in (float(word) for word in goal.split() if word.startswith(".")):
            left.plot([bound, bound], [y - 0.3, y + 0.3], color="C3", lw=1.5)
    labels = [f"{text} (n = {figures[f'{key}_n']})" for key, text, _ in reversed(shown)]
    left.set_yticks(range(len(shown)), labels)
    left.set(xlim=(-0.02, 1.02), xlabel="rate, 95 % Wilson interval; goal in red")
    singles = [s for s in scores if s.kind == "single"]
    edges = np.array([0.8, 2.0, 3.0, 5.0, 10.0])
    for name, colour in (("module", "C0"), ("joint", "C1")):
        rates = [
            np.mean([bool(getattr(s, name)) for s in singles if low <= s.size < high] or [np.nan])
            for low, high in zip(edges, edges[1:])
        ]
        right.plot(np.sqrt(edges[1:] * edges[:-1]), rates, "o-", color=colour, label=f"right {name}")
    right.set(xscale="log", xlabel="size of the effect, times its detection limit", ylim=(-0.02, 1.02))
    right.set_xticks(edges, [f"{edge:g}" for edge in edges])
    right.minorticks_off()
    right.legend(loc="lower right")
    figure.savefig(path)
    plt.close(figure)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"

"""finetune.html: from gap to recovered success on one page, in plain English."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure
from sim2real.effects.patch import Patch
from sim2real.effects.sentences import ValueWithInterval, describe_effect

from np_common.html_pages import page, style, svg
from np_evaluation.finetune.summary import KEPT

BLUE, RED, GREEN, GREY = "#1f5fa8", "#b02020", "#1d7a2a", "#8a8f98"
BARS = (
    ("nominal", "simulator without the gap", GREY),
    ("patched", "simulator with the gap", RED),
    ("patched_corrected", "the same, corrected", GREEN),
    ("patched_after", "the same, trained on", GREEN),
    ("reality", "the robot itself", RED),
    ("reality_corrected", "the same, corrected", GREEN),
    ("reality_after", "the same, trained on", GREEN),
)
"""Key of `success`, what it is called, colour."""


def sentence(result: Mapping) -> str:
    """The result in sentences."""
    if not result["effects"]:
        return "The diagnosis found no gap: there is nothing to train for."
    nominal, predicted = result["success"]["nominal"], result["success"]["patched"]
    sentences = [
        f"The simulator succeeds in {_percent(nominal)} of the episodes of the {result['domain']}, with what was found in {_percent(predicted)}."
    ]
    if result["cause"] is None or result["lost"]["ci95"][0] <= 0:
        sentences.append("That is no loss beyond chance.")
    else:
        cost, lost = result["costs"][result["cause"]]["value"], result["lost"]["value"]
        sentences.append(f"Most of it goes to {_name(result['cause'])}: {_points(cost)} of {_points(lost)} points.")
    if result["corrected"]:
        names = ", ".join(_name(name) for name in result["corrected"])
        worse = ", which is not better: leave it" if result["kept"] == "before" else ""
        sentences.append(
            f"With {names} corrected in detector and driver it comes to {_percent(result['success']['patched_corrected'])}{worse}."
        )
    if result["learned"] is None:
        sentences.append("Nothing was trained: training has none of what is left.")
    else:
        after = _percent(result["success"]["patched_after"])
        worse = "" if result["kept"] == "trained" else ", which is not better: keep the old ones"
        sentences.append(f"Trained on, the policies come to {after}{worse}.")
    if result["success_before"] is not None and result["kept"] != "before":
        before, after = (
            result["success"]["reality"],
            result["success"][KEPT[result["kept"]].replace("patched", "reality")],
        )
        sentences.append(f"On the robot itself: {_percent(before)} before, {_percent(after)} after.")
    elif result["success_before"] is None:
        sentences.append("On the robot itself nothing was measured yet.")
    return " ".join(sentences)


def render(result: Mapping, patch: Patch, folder: Path) -> str:
    """The page as text, with its pictures in it. folder: of the results, whose training's log is drawn."""
    return page(
        "np_evaluation",
        "finetune.html.j2",
        result=result,
        sentence=sentence(result),
        found=[_describe(effect) for effect in patch.effects],
        bars=[(words, result["success"][key]) for key, words, _ in BARS if key in result["success"]],
        costs=[(_name(name), cost) for name, cost in result["costs"].items()],
        success_plot=_plot(_success, result),
        cost_plot=_plot(_costs, result) if result["costs"] else "",
        curve=_plot(_curve, folder / "training" / "log.csv") if result["learned"] else "",
    )


def _plot(draw, what) -> str:
    with style():
        figure = Figure(figsize=(6.4, 2.4), layout="constrained")
        draw(figure.subplots(), what)
    return svg(figure)


def _success(ax, result: Mapping) -> None:
    bars = [(words, result["success"][key], colour) for key, words, colour in BARS if key in result["success"]]
    for row, (_, rate, colour) in enumerate(reversed(bars)):
        low, high = rate["ci95"]
        ax.barh(row, 100 * rate["value"], color=colour, height=0.6)
        ax.plot([100 * low, 100 * high], [row, row], color="#222", linewidth=1.2)
    ax.set(yticks=range(len(bars)), yticklabels=[words for words, *_ in reversed(bars)], xlim=(0, 100))
    ax.set_xlabel("success, % of episodes; line: 95 % interval")
    ax.grid(axis="y", visible=False)


def _costs(ax, result: Mapping) -> None:
    rows = list(reversed(result["costs"].items()))
    for row, (_, cost) in enumerate(rows):
        low, high = cost["ci95"]
        ax.barh(row, 100 * cost["value"], color=BLUE, height=0.6)
        ax.plot([100 * low, 100 * high], [row, row], color="#222", linewidth=1.2)
    ax.set(yticks=range(len(rows)), yticklabels=[_name(name) for name, _ in rows])
    ax.set_xlabel("points of success that it costs; line: 95 % interval")
    ax.grid(axis="y", visible=False)


def _curve(ax, log: Path) -> None:
    with log.open(encoding="utf-8") as lines:
        rows = [(float(r["elapsed"]), float(r["success"])) for r in csv.DictReader(lines) if float(r["episodes"])]
    begun = rows[0][0] if rows else 0.0
    ax.plot([(at - begun) / 60 for at, _ in rows], [100 * success for _, success in rows], color=GREEN, linewidth=1)
    ax.set(xlabel="minutes of training", ylabel="success of drawn actions, %", ylim=(0, 102))


def _describe(effect) -> str:
    """An effect of the patch as text; intervals are in the report of the diagnosis."""
    values = {name: _Plain(value) for name, value in effect.values.items()}
    return describe_effect(effect.definition, effect.component, values, "the simulator")


class _Plain(ValueWithInterval):
    """A number without an interval."""

    def __init__(self, value: float):
        super().__init__(value, value, value)

    def __format__(self, spec: str) -> str:
        text = super().__format__(spec)
        begin, end = text.find(" ("), text.find(")")
        return text[:begin] + text[end + 1 :]


def _name(part: str) -> str:
    return part.replace("_", " ").removesuffix(" at camera").removesuffix(" at contact").removesuffix(" at object")


def _percent(rate: Mapping) -> str:
    low, high = rate["ci95"]
    return f"{100 * rate['value']:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _points(share: float) -> str:
    return f"{100 * share:.0f}"

"""Results of contact: engines against rigid theory, and what the doctor says of real pushes."""

from __future__ import annotations

from collections.abc import Mapping

from pages.markdown import table


def static_bench(data: Mapping) -> tuple[str, str]:
    """Headline and body of the static bench: a row a question, a column an engine, rigid theory first."""
    columns = data["figures"]
    questions = list(columns["rigid theory"])
    body = table(("", *columns), ((question, *(part[question] for part in columns.values())) for question in questions))
    creep = "creep at .9 of the load that slides, mm/s"
    headline = f"{creep}: " + ", ".join(
        f"{name} {abs(part[creep]):.2g}" for name, part in columns.items() if name != "rigid theory"
    )
    return headline, body


def pushes(data: Mapping) -> tuple[str, str]:
    """Headline and body of what changed between real pushes: each new one alone, all together, the reference beside itself."""
    figures, known = data["figures"], data["set_up"]
    headline = ", ".join(f"{name} {count} of {figures['new']}" for name, count in figures["named"].items())
    headline += f"; false alarms {figures['false_alarms']} of {figures['reference']}"
    body = (
        f"Reference, {known['pushes']} pushes: friction {known['friction_N']:.2f} N, {100 * known['friction_run_to_run']:.0f} % "
        f"between runs, radius of support over side {known['support_over_side']:.2f}, tip's friction {known['tip_friction']:.2f}, "
        f"half side {1e3 * known['half_side_m']:.1f} mm.\n\n"
    )
    asked = {"all new ones": data["new_together"], **data["new_alone"], **data["reference_alone"]}
    rows = [(name, found["verdict"], "; ".join(_said(one) for one in found["named"])) for name, found in asked.items()]
    return headline, body + table(("pushes", "verdict", "named, with 95 % interval"), rows)


def _said(named: Mapping) -> str:
    """One effect, its sizes and what could stand in its place."""
    sizes = ", ".join(
        f"{'x' if size['is_factor'] else ''}{size['value']:.3g} ({size['low']:.3g} to {size['high']:.3g})"
        for size in named["sizes"]
    )
    rivals = ", ".join("/".join(rival) for rival in named["rivals"])
    return f"{'/'.join(named['effect'])} {sizes}" + (f", or {rivals}" if rivals else "")

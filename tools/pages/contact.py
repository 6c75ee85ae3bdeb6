"""Results of contact: engines against rigid theory, and what the doctor says of real pushes and of things that slide."""

from __future__ import annotations

from collections.abc import Mapping

from pages.markdown import paragraph, rate, table


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


def laws(data: Mapping) -> tuple[str, str]:
    """Headline and body of released policies under laws of contact: a row a domain and law, its failures in words."""
    rows = [
        (
            played["domain"],
            played["contact"],
            f"{played['successes']} of {played['episodes']}",
            rate(played["success"], played["ci95"]),
            f"{played['duration_s']:.1f}",
            f"{1e3 * played['distance_m']:.1f}",
            "; ".join(f"task {one['number']}: {one['reason']}" for one in played["failed"]),
        )
        for played in data["played"]
    ]
    together = {
        law: [sum(p[key] for p in data["played"] if p["contact"] == law) for key in ("successes", "episodes")]
        for law in {played["contact"]: None for played in data["played"]}
    }
    headline = ", ".join(f"{law} {done} of {of}" for law, (done, of) in together.items())
    columns = (
        "domain",
        "contact",
        "successes",
        "success, 95 % Wilson interval",
        "s, median",
        "mm off, median",
        "failed",
    )
    return headline, table(columns, rows)


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


def slid(data: Mapping) -> tuple[str, str]:
    """Headline and body of real tosses and of a real tray."""
    tosses, tray = data["tosses"], data["tray"]
    mu, low, high = tosses["friction"]
    more, *bounds = (100 * share for share in tosses["relative"])
    headline = f"tosses: friction {mu:.3f} ({low:.3f} to {high:.3f}); tray: {tray['verdict']}"
    halves = " and ".join(f"{one:.3f} ({least:.3f} to {most:.3f})" for one, least, most in tosses["halves"])
    body = paragraph(
        f"*Tosses.* {tosses['slides']} free slides in {tosses['tosses']} tosses: friction {mu:.3f} ({low:.3f} to {high:.3f}), "
        f"{tosses['spread']:.3f} from slide to slide; every other slide {halves}; the table is level within "
        f"{1e3 * max(map(abs, tosses['tilt'])):.1f} mrad. Against what the authors simulate it with, .18: {', '.join(tosses['named']) or 'nothing'}, "
        f"{more:.0f} % more ({bounds[0]:.0f} to {bounds[1]:.0f}). Nothing is said of the mass, on which a free slide does not depend."
    )
    body += "\n\n"
    groups = ((n, one["groups"], one["held"], f"{one['half_width']:.4f}") for n, one in tosses["groups"].items())
    body += table(("slides", "groups", "intervals that hold what all say", "half of an interval, median"), groups)
    body += (
        f"\n*Tray.* {tray['verdict']}: {tray['doubt']}.\n\n" if tray["doubt"] else f"\n*Tray.* {tray['verdict']}.\n\n"
    )
    runs = (
        (name, f"{1e3 * r['way']:.1f}", f"{r['friction']:.2f}", f"{1e3 * r['delay']:.0f}", f"{r['left']:.2f}")
        for name, r in tray["runs"].items()
    )
    return headline, body + table(
        ("run", "way of the block, mm", "coefficient", "camera behind the hand, ms", "left of the way"), runs
    )


def _said(named: Mapping) -> str:
    """One effect, its sizes and what could stand in its place."""
    sizes = ", ".join(
        f"{'x' if size['is_factor'] else ''}{size['value']:.3g} ({size['low']:.3g} to {size['high']:.3g})"
        for size in named["sizes"]
    )
    rivals = ", ".join("/".join(rival) for rival in named["rivals"])
    return f"{'/'.join(named['effect'])} {sizes}" + (f", or {rivals}" if rivals else "")

"""Results of contact against rigid theory."""

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

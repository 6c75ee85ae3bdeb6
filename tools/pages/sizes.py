"""Objects of another size than the weights know: which contacts can be reached, and what becomes of episodes."""

from __future__ import annotations

from collections.abc import Mapping

from pages.markdown import rate, table


def sized(data: Mapping) -> tuple[str, str]:
    """Headline and body."""
    contacts = data["contacts"]
    body = f"Contacts that the arm reaches without collision, of {contacts['tasks']} tasks (seed {contacts['seed']}), and the median distance of hand "
    body += "and fingers to everything:\n\n" + table(
        ("domain", "all edges times", "network alone", "mm", "as the node asks it", "mm"),
        (
            (
                row["domain"],
                row["factor"],
                *(value for way in ("alone", "asked") for value in (row[way]["reached"], row[way]["clear_mm"])),
            )
            for row in contacts["contacts"]
        ),
    )
    played = data["played"]
    body += f"\nEpisodes, {played['what']}:\n\n```\n{played['command']}\n```\n\n" + table(
        ("domain", "all edges times", "contact chosen by the network alone", "as the node asks it"),
        (
            (
                row["domain"],
                row["factor"],
                *(
                    f"{row[way]['successes']} of {row[way]['episodes']}: {_rate(row[way])}"
                    for way in ("alone", "asked")
                ),
            )
            for row in played["rows"]
        ),
    )
    larger = [row for row in contacts["contacts"] if row["factor"] >= 1.1]
    reached = [f"{min(row[way]['reached'] for row in larger):g}" for way in ("alone", "asked")]
    return (
        f"contacts reached on boxes 10 and 20 % larger: {reached[1]} at least, {reached[0]} by the network alone",
        body,
    )


def _rate(one: Mapping) -> str:
    return rate(one["success"], one["ci95"])

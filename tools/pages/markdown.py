"""Pieces of a page: tables, numbers, the line that names its source, generated parts of a page written by hand."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

WIDTH = 116


def head(title: str, source: str, text: str = "") -> str:
    """Title of a generated page, with what it was written from, and an introduction."""
    return f"<!-- Written by `make docs` from {source}: do not edit. -->\n# {title}\n\n" + (
        paragraph(text) + "\n\n" if text else ""
    )


def paragraph(text: str) -> str:
    """The text in lines of at most WIDTH characters; words longer than that stay whole."""
    return textwrap.fill(" ".join(text.split()), WIDTH, break_long_words=False, break_on_hyphens=False)


def fill(page: str, **parts: str) -> str:
    """Replace each named part of a page, the text between `<!-- name -->` and `<!-- /name -->`. ValueError if either is missing or repeated."""
    for name, content in parts.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"expected {begin} and {end} once, got {page.count(begin)} and {page.count(end)}")
        before, after = page.split(begin)[0], page.split(end)[1]
        page = before + begin + content + end + after
    return page


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; None is an empty cell, and what would end a cell is escaped."""
    lines = [f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    lines += [f"| {' | '.join(cell(value) for value in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def cell(value: object) -> str:
    """A value as the text of a table's cell."""
    if value is None:
        return ""
    if isinstance(value, float):
        return number(value)
    return " ".join(str(value).replace("|", "\\|").split())


def number(value: float) -> str:
    """Four significant digits; whole numbers as they are."""
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e12 else f"{value:.4g}"


def rate(value: float, interval: Sequence[float]) -> str:
    """A rate with its 95 % interval."""
    return f"{value:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"

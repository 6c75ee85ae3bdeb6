"""How a threshold is declared: its value with unit, meaning and source, as the metadata of a dataclass field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

JUDGEMENT = "engineering judgement"
DEVELOPMENT = "engineering judgement, tried on cases of the blind test that were open by then"
NUMERICS = "numerical effort or tolerance, chosen for run time and convergence, not by a study"


def threshold(value: Any, unit: str, meaning: str, source: str) -> Any:
    """A dataclass field with this default, and with the other three as its metadata.

    unit: "1" for a ratio or share, the thing counted for a count. source: a publication, what it was measured
    on, or that it is engineering judgement.
    """
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True)
class Entry:
    """One threshold for the documentation. name: "group.field"."""

    name: str
    value: Any
    unit: str
    meaning: str
    source: str


def entries(thresholds: Any, prefix: str = "") -> Iterator[Entry]:
    """Every threshold of a dataclass and of the dataclasses in it, in the order of their declaration.

    Raises ValueError for a field without unit, meaning or source.
    """
    for own in fields(thresholds):
        name, value = prefix + own.name, getattr(thresholds, own.name)
        if is_dataclass(value):
            yield from entries(value, f"{name}.")
            continue
        missing = [key for key in ("unit", "meaning", "source") if not own.metadata.get(key)]
        if missing:
            raise ValueError(f"threshold {name}: expected unit, meaning and source, got no {', '.join(missing)}")
        yield Entry(name, value, *(own.metadata[key] for key in ("unit", "meaning", "source")))


def table(thresholds: Any) -> str:
    """All thresholds as a Markdown table."""
    rows = ["| threshold | value | unit | meaning | source |", "|---|---|---|---|---|"]
    for e in entries(thresholds):
        rows.append(f"| `{e.name}` | {_text(e.value)} | {e.unit} | {e.meaning} | {e.source} |")
    return "\n".join(rows) + "\n"


def _text(value: Any) -> str:
    return ", ".join(map(_text, value)) if isinstance(value, tuple) else f"{value:g}"

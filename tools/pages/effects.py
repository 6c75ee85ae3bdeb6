"""docs/reference/effects.md: the catalogue of effects, from the records of np_effects or the tables before them."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from importlib.resources import files
from types import SimpleNamespace

import yaml

from np_description.patch import PARAMETERS
from pages.markdown import head, table

INTRODUCTION = """What an arm may have that its nominal simulator has not. An entry of `patch.yaml` is an id, a
component (a joint's name, or `arm`) and the parameters below, in SI units, as changes against the nominal arm. A module
is where reports say that an effect sits."""


def records() -> Iterator[SimpleNamespace]:
    """Every effect as id, module, model, carriers, and parameters with name, unit, lower, upper.

    Of np_effects.RECORDS where there are any; else of the patch's own table of names and the doctor's catalogue, which
    know neither units nor bounds nor carriers.
    """
    known = getattr(importlib.import_module("np_effects"), "RECORDS", None)
    if known is not None:
        yield from known.values()
        return
    text = (files("np_diagnosis") / "data" / "gap_effects.yaml").read_text(encoding="utf-8")
    catalogue = {entry["id"]: entry for entry in yaml.safe_load(text)["effects"]}
    for name, parameters in PARAMETERS.items():
        named = [SimpleNamespace(name=p, unit="", lower=None, upper=None) for p in parameters]
        entry = catalogue[name]
        yield SimpleNamespace(
            id=name, module=entry["module"], model=entry["model"], carriers=(), parameters=tuple(named)
        )


def page() -> str:
    """The page: one table of all effects."""
    rows = []
    for record in records():
        parameters = ", ".join(f"`{p.name}`{f' {p.unit}' if p.unit else ''}{_range(p)}" for p in record.parameters)
        rows.append((f"`{record.id}`", record.module, record.model, parameters, ", ".join(record.carriers)))
    if not any(row[-1] for row in rows):
        rows = [row[:-1] for row in rows]
    header = ("effect", "module", "model", "parameters", "carried by")[: len(rows[0])]
    return head("Effects", "the catalogue", INTRODUCTION) + table(header, rows)


def _range(parameter) -> str:
    if parameter.lower is None and parameter.upper is None:
        return ""
    low = "" if parameter.lower is None else f"{parameter.lower:g}"
    high = "" if parameter.upper is None else f"{parameter.upper:g}"
    return f" ({low} to {high})" if low and high else f" (from {low})" if low else f" (to {high})"

"""docs/reference/report_schema.md: report.json of the diagnosis, from its JSON schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib.resources import files

from pages.markdown import head, table

INTRODUCTION = """`report.json` of `ros2 run np_diagnosis diagnose` keeps this schema
(`sim2real/data/gap_report.schema.json`) and may have keys beyond it. `[]` stands for each item of a
list, `<name>` for each key, `*` for a key that is always there. [How to read it](../guide/read_the_report.md)."""


def page() -> str:
    """The page: one row a key."""
    schema = json.loads((files("sim2real") / "data" / "gap_report.schema.json").read_text(encoding="utf-8"))
    return head("The report of the diagnosis", "its schema", INTRODUCTION) + table(
        ("key", "type", "meaning"), rows(schema, "")
    )


def rows(schema: Mapping, prefix: str) -> Iterator[tuple[str, str, str]]:
    """The keys of an object, with those inside them."""
    required = schema.get("required", ())
    properties = dict(schema.get("properties", {}))
    if isinstance(schema.get("additionalProperties"), Mapping):
        properties["<name>"] = schema["additionalProperties"]
    for name, of in properties.items():
        path = f"{prefix}{name}"
        yield f"`{path}`{'*' * (name in required)}", kind(of), of.get("description", "")
        yield from rows(of, f"{path}.")
        if isinstance(of.get("items"), Mapping):
            yield from rows(of["items"], f"{path}[].")


def kind(of: Mapping) -> str:
    """Type of a value, with what is allowed."""
    if "const" in of:
        return f"`{of['const']}`"
    if "enum" in of:
        return "one of " + ", ".join(f"`{value}`" for value in of["enum"])
    types = of.get("type", "any")
    text = " or ".join(types) if isinstance(types, list) else types
    if "minimum" in of or "maximum" in of:
        text += f", {of.get('minimum', '')} to {of.get('maximum', '')}"
    if of.get("items"):
        count = f" {of['minItems']}" if of.get("minItems") == of.get("maxItems") and "minItems" in of else ""
        text += f" of{count} {of['items'].get('type', 'values')}s" if "type" in of["items"] else ""
    return text

"""The part of JSON Schema that the report's schema uses; a keyword outside of it is an error, not a pass."""

from __future__ import annotations

import math

_TYPES = {"object": dict, "array": list, "string": str, "number": (int, float), "null": type(None)}
_NOTES = {"$schema", "title", "description"}
_KNOWN = _NOTES | {
    "type",
    "required",
    "properties",
    "additionalProperties",
    "items",
    "enum",
    "const",
    "minimum",
    "maximum",
    "minItems",
    "maxItems",
}


def validate(value, schema: dict, path: str = "report") -> None:
    """Raise ValueError naming the first place where `value` breaks the schema."""
    unknown = set(schema) - _KNOWN
    if unknown:
        raise ValueError(f"schema of {path}: cannot check {', '.join(sorted(unknown))}")
    types = schema.get("type", [])
    types = [types] if isinstance(types, str) else types
    if types and not any(isinstance(value, _TYPES[name]) and not isinstance(value, bool) for name in types):
        raise ValueError(f"{path}: expected {' or '.join(types)}, got {value!r}")
    if "const" in schema and value != schema["const"] or "enum" in schema and value not in schema["enum"]:
        raise ValueError(f"{path}: expected {schema.get('enum', schema.get('const'))}, got {value!r}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{path}: expected a finite number, got {value}")
    if isinstance(value, (int, float)) and not (
        schema.get("minimum", -math.inf) <= value <= schema.get("maximum", math.inf)
    ):
        raise ValueError(f"{path}: expected {schema.get('minimum')} to {schema.get('maximum')}, got {value}")
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
            raise ValueError(
                f"{path}: expected {schema.get('minItems', 0)} to {schema.get('maxItems', 'any')} items, "
                f"got {len(value)}"
            )
        for i, item in enumerate(value):
            validate(item, schema.get("items", {}), f"{path}[{i}]")
    if isinstance(value, dict):
        missing = [name for name in schema.get("required", ()) if name not in value]
        if missing:
            raise ValueError(f"{path}: expected {', '.join(missing)}")
        for name, item in value.items():
            validate(
                item,
                schema.get("properties", {}).get(name, schema.get("additionalProperties", {})),
                f"{path}.{name}",
            )

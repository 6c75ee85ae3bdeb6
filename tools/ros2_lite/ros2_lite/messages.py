"""Messages and requests: their classes by name, their fields from YAML, and as plain values."""

from __future__ import annotations

import importlib
import re

import yaml

_LIST = re.compile(r"sequence<(\w+)/(\w+)(?:, \d+)?>|(\w+)/(\w+)\[\d+\]")


def interface(kind: str, name: str) -> type:
    """The class of "package/kind/Name", with kind msg or srv. Raises ValueError for an unknown one."""
    package, _, rest = name.partition(f"/{kind}/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), rest)
    except (ImportError, AttributeError, TypeError, ValueError):
        example = {"msg": "std_msgs/msg/Float64", "srv": "std_srvs/srv/Trigger"}[kind]
        raise ValueError(f"type: expected one as {example}, got {name!r}") from None


def fill(message: object, values: object) -> None:
    """Set fields of a message from dictionaries and lists, nested as the message is. Raises ValueError for other fields or types."""
    known = message.get_fields_and_field_types()
    if not isinstance(values, dict) or not values.keys() <= known.keys():
        raise ValueError(f"values: expected fields of {known}, got {values}")
    for name, value in values.items():
        if hasattr(own := getattr(message, name), "get_fields_and_field_types"):
            fill(own, value)
            continue
        if (found := _LIST.fullmatch(known[name])) and isinstance(value, list):
            element = interface("msg", "{}/msg/{}".format(*filter(None, found.groups())))
            value, given = [element() for _ in value], value
            for part, fields in zip(value, given):
                fill(part, fields)
        try:
            type(message)(check_fields=True, **{name: value})  # an attribute would take anything
            setattr(message, name, value)
        except AssertionError as error:
            raise ValueError(f"values: {name}: expected {known[name]}, got {value!r}") from error


def fill_from_yaml(kind: type, text: str) -> object:
    """A message of the class with the fields that YAML text gives. Raises ValueError."""
    message = kind()
    try:
        fill(message, yaml.safe_load(text) or {})
    except yaml.YAMLError as error:
        raise ValueError(f"values: expected YAML, got {text!r}: {error}") from None
    return message


def plain(value, limit: int | None):
    """A message as dictionaries, lists and numbers; arrays cut after `limit` entries."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: plain(getattr(value, field), limit) for field in value.get_fields_and_field_types()}
    if isinstance(value, (bytes, bytearray)):
        value = list(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        shown = [plain(item, limit) for item in value[:limit]]
        return shown + ["..."] if limit is not None and len(value) > limit else shown
    return value

"""Messages that no node should send: random ones of a type, real ones with something broken, and bytes that are none."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from copy import deepcopy
from importlib import import_module

import numpy as np

from np_description.panda import JOINT_NAMES, STATE_NAMES

LENGTHS = (0, 1, 2, 3, 7, 8, 9, 14, 100)
FEW = (
    0,
    1,
    1,
    1,
    2,
    3,
)  # of messages inside a message: a hundred of a hundred would be megabytes, which arrive when they like
NUMBERS = (0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 1e-320, 3.14, 0.04)
TEXTS = (
    "",
    "panda_link0",
    "nobody",
    "phase",
    "post",
    "pre",
    "failed",
    "\u2603" * 3,
    "x" * 500,
    *JOINT_NAMES[:2],
    *STATE_NAMES[-1:],
)
_ARRAYS = {
    "double": "d",
    "float": "f",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
}
_ARRAYS |= {"int64": "q", "uint64": "Q"}
_LIST = re.compile(r"sequence<(.+?)(?:, \d+)?>$|(.+)\[(\d+)\]$")


def message_type(name: str) -> type:
    """The class of "package/msg/Name"."""
    package, _, kind = name.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), kind)


def random_message(kind: type, rng: np.random.Generator):
    """A message whose every field is random, of the right type."""
    message = kind()
    for name, type_name in kind.get_fields_and_field_types().items():
        setattr(message, name, _random(type_name, rng))
    return message


def break_message(message, rng: np.random.Generator):
    """A copy of a real message with one to three of its fields random."""
    changed = deepcopy(message)
    for _ in range(int(rng.integers(1, 4))):
        at = changed
        while True:
            fields = at.get_fields_and_field_types()
            if not fields:
                break
            name = list(fields)[rng.integers(len(fields))]
            value = getattr(at, name)
            inner = value[int(rng.integers(len(value)))] if isinstance(value, list) and value else value
            if hasattr(inner, "get_fields_and_field_types") and rng.random() < 0.8:
                at = inner
                continue
            setattr(at, name, _random(fields[name], rng))
            break
    return changed


def break_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Serialized bytes cut off, or with some of them changed after the four of the encapsulation header."""
    kept = bytearray(data[: int(rng.integers(4, max(5, len(data))))] if rng.random() < 0.5 else data)
    for _ in range(int(rng.integers(1, 5))):
        if len(kept) > 4:
            kept[int(rng.integers(4, len(kept)))] = int(rng.integers(256))
    return bytes(kept)


def _random(type_name: str, rng: np.random.Generator):
    if found := _LIST.match(type_name):
        inner = found[1] or found[2]
        count = int(found[3]) if found[3] else int(rng.choice(FEW if "/" in inner else LENGTHS))
        values = [_random(inner, rng) for _ in range(min(count, 40))]
        values = (values * (count // max(1, len(values)) + 1))[:count]
        if inner in _ARRAYS:
            return np.array(values, dtype=_ARRAYS[inner]) if found[2] else array(_ARRAYS[inner], values)
        return values
    if type_name in ("double", "float"):
        value = _choice(NUMBERS, rng) if rng.random() < 0.5 else float(rng.normal(scale=10.0 ** rng.integers(-3, 4)))
        return float(np.float32(np.clip(value, -3e38, 3e38))) if type_name == "float" and np.isfinite(value) else value
    if type_name == "boolean":
        return bool(rng.integers(2))
    if type_name in ("octet", "byte"):
        return bytes([int(rng.integers(256))])
    if type_name.startswith(("string", "wstring")):
        return _choice(TEXTS, rng)
    if type_name in _ARRAYS:
        limits = np.iinfo(array(_ARRAYS[type_name]).typecode)
        return int(_choice((limits.min, limits.max, 0, 1, int(rng.integers(0, 100))), rng))
    package, _, kind = type_name.partition("/")
    return random_message(message_type(f"{package}/msg/{kind}"), rng)


def _choice(values: Sequence, rng: np.random.Generator):
    return values[int(rng.integers(len(values)))]

"""An object of one's own: a YAML file, in m, kg, N."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import yaml

from np_description.objects.parts import split_object
from np_description.objects.spec import Contents, Friction, ObjectSpec, Softness, Surface
from np_description.objects.table import SURFACES

SUFFIXES = (".yaml", ".yml")
_NEEDED = ("name", "domain", "size", "mass", "surface")
_OPTIONAL = ("centre_of_mass", "inertia", "compliance", "contents")


class ObjectError(ValueError):
    """A file that describes no object: what was expected and what came, in one line."""


def read_object(path: str | Path) -> ObjectSpec:
    """The object in a file. Raises ObjectError."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "no text"
        raise ObjectError(f"object {path}: expected a YAML file that can be read, got: {reason}") from error
    return parse_object(text, str(path))


def parse_object(text: str, source: str) -> ObjectSpec:
    """The object that YAML text describes; source: what errors call it. Raises ObjectError."""
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ObjectError(f"object {source}: expected YAML, got: {' '.join(str(error).split())}") from error
    try:
        return _object(content)
    except ValueError as error:
        raise ObjectError(f"object {source}: {error}") from error


def object_text(spec: ObjectSpec) -> str:
    """The object on one line that `parse_object` reads: what a recording keeps, wherever the file goes."""
    content = {
        "name": spec.name,
        "domain": spec.domain,
        "size": list(spec.size),
        "mass": spec.mass,
        "surface": {
            "name": spec.surface.name,
            **{
                pair: {
                    "friction": getattr(spec.surface, pair).coefficient,
                    "source": getattr(spec.surface, pair).source,
                }
                for pair in ("finger", "table")
            },
        },
        "centre_of_mass": list(spec.centre_of_mass),
    }
    if spec.inertia is not None:
        content["inertia"] = list(spec.inertia)
    if spec.compliance:
        content["compliance"] = {"stiffness": spec.compliance.stiffness, "travel": spec.compliance.travel}
    if spec.contents:
        inside = spec.contents
        content["contents"] = {"mass": inside.mass, "clearance": list(inside.clearance), "friction": inside.friction}
    return json.dumps(content, sort_keys=True)


def _object(content) -> ObjectSpec:
    _keys("the file", content, _NEEDED, _OPTIONAL)
    for key in ("name", "domain"):
        if not isinstance(content[key], str) or not content[key]:
            raise ValueError(f"{key}: expected a word, got {content[key]!r}")
    values = {key: _tuple(content[key]) for key in content if key not in ("surface", "compliance", "contents")}
    if content.get("compliance") is not None:
        _keys("compliance", content["compliance"], ("stiffness", "travel"))
        values["compliance"] = Softness(**content["compliance"])
    if content.get("contents") is not None:
        _keys("contents", content["contents"], ("mass", "clearance", "friction"))
        values["contents"] = Contents(**{key: _tuple(value) for key, value in content["contents"].items()})
    spec = ObjectSpec(**values, surface=_surface(content["surface"]))
    split_object(spec)  # has an inertia with room for what moves
    return spec


def _surface(content) -> Surface:
    if isinstance(content, str):
        if content not in SURFACES:
            raise ValueError(f"surface: expected one of {', '.join(SURFACES)}, or its frictions, got {content!r}")
        return SURFACES[content]
    _keys("surface", content, ("name", "finger", "table"))
    pairs = {}
    for pair in ("finger", "table"):
        _keys(f"surface.{pair}", content[pair], ("friction", "source"))
        try:
            pairs[pair] = Friction(content[pair]["friction"], str(content[pair]["source"]))
        except ValueError as error:
            raise ValueError(f"surface.{pair}.{error}") from error
    return Surface(str(content["name"]), **pairs)


def _keys(where: str, content, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    if not isinstance(content, Mapping):
        raise ValueError(f"{where}: expected the keys {', '.join(needed)}, got {content!r}")
    missing = [key for key in needed if key not in content]
    unknown = [str(key) for key in content if key not in needed + optional]
    if missing:
        raise ValueError(
            f"{where}: expected the key {missing[0]}, got only {', '.join(map(str, content)) or 'nothing'}"
        )
    if unknown:
        raise ValueError(f"{where}: expected no keys but {', '.join(needed + optional)}, got {unknown[0]}")


def _tuple(value):
    return tuple(value) if isinstance(value, list) else value

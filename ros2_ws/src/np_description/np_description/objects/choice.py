"""Which object a domain is played with: its own, a row of the table, a file, or the text of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from np_description.domains import Region, Task, find_domain
from np_description.objects.files import SUFFIXES, ObjectError, object_text, parse_object, read_object
from np_description.objects.spec import ObjectSpec
from np_description.objects.table import rows_of

DEFAULT = "default"


def find_object(domain: str, object_ref: str) -> ObjectSpec | None:
    """The object that `object_ref` names for a domain: a row, a .yaml file, or the text of one; None for its own.

    Raises ValueError, which an ObjectError is, for a name that is none, and for an object of another domain.
    """
    if object_ref == DEFAULT:
        return None
    if object_ref.lstrip().startswith("{"):
        spec = parse_object(object_ref, "(text)")
    elif object_ref.endswith(SUFFIXES):
        spec = read_object(object_ref)
    elif object_ref in (rows := rows_of(domain)):
        return rows[object_ref].spec
    else:
        raise ValueError(f"object: expected one of {', '.join(rows)}, or a .yaml file, got {object_ref!r}")
    if spec.domain != domain:
        raise ObjectError(f"object {spec.name}: expected one of domain {domain}, got one of {spec.domain}")
    return spec


def domain_with(name: str, object_ref: str = DEFAULT) -> Task:
    """The domain called `name`, played with the object that `object_ref` names. Raises what find_domain and find_object raise."""
    domain = find_domain(name)
    spec = find_object(domain.name, object_ref)
    return domain if spec is None else place_object(domain, spec)


def read_domain(information: Mapping[str, object]) -> Task:
    """The domain of a recording, with the object that it was played with, by what the recorder kept of the run."""
    return domain_with(str(information.get("domain", "card")), str(information.get("object", DEFAULT)))


def embed_object_text(domain: str, object_ref: str) -> str:
    """`object_ref` such that it means the same elsewhere: a file's content instead of its path. Raises what find_object raises."""
    spec = find_object(domain, object_ref)
    return object_text(spec) if spec is not None and object_ref.endswith(SUFFIXES) else object_ref


def object_reference(domain: Task) -> str:
    """The reference from which `domain_with` makes this domain's object: "default", the name of a row, or the text of an object."""
    spec = domain.object
    if spec is None:
        return DEFAULT
    row = rows_of(domain.name).get(spec.name)
    is_row = row is not None and row.spec == spec and spec.name != DEFAULT
    return spec.name if is_row else object_text(spec)


def place_object(domain: Task, spec: ObjectSpec) -> Task:
    """The domain with this object: starts and goals beside obstacles keep the gap to them that the domain's own object has."""
    regions = [_move_region(domain, region, spec) for region in (domain.start, *domain.goals)]
    return replace(
        domain,
        half_size=spec.half_size,
        density=spec.density,
        object=spec,
        start=regions[0],
        goals=tuple(regions[1:]),
    )


def _move_region(domain: Task, region: Region, spec: ObjectSpec) -> Region:
    """The region, away from each obstacle that it stands beside by as much as the object is larger."""
    if region.surface:
        return region
    for box in domain.obstacles:
        for axis, name in enumerate("xy"):
            low, high = getattr(region, name)
            side = np.sign(low + high - 2 * box.centre[axis])
            nearest = low if side > 0 else high
            if abs(nearest - box.centre[axis]) < box.half_size[axis]:
                continue
            shift = side * (
                _horizontal_reach(region, spec.half_size, axis) - _horizontal_reach(region, domain.half_size, axis)
            )
            if shift:
                region = replace(region, **{name: (low + shift, high + shift)})
    return region


def _horizontal_reach(region: Region, half_size: tuple[float, float, float], axis: int) -> float:
    """Largest extent of an object along x or y from its middle, over the yaws of the region, m."""
    if region.quarter_turns:
        return float(np.linalg.norm(sorted(half_size)[1:]))
    if region.yaw[0] == region.yaw[1] == 0.0 and not region.pitch:
        return half_size[axis]
    return float(np.linalg.norm(half_size[:2]))

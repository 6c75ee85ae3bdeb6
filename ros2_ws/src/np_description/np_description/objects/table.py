"""The 21 objects of the paper's Table III (Kim et al., IROS 2023): seven in each domain.

Masses, surfaces and which are not rigid are the paper's. It prints no sizes: every row has the size of its domain's own object. How
soft, and what slides how far, are this project's estimates: the guide describes how to measure an object at hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from np_description.contact.model import HARD
from np_description.domains import BUMP, CARD, DOMAINS, WALL, Task
from np_description.objects.spec import Contents, Friction, ObjectSpec, Softness, Surface

_TRAINED = "np_description.contact: what the released weights were trained with"
_RUBBER, _TABLE = Friction(HARD.finger, _TRAINED), Friction(HARD.table, _TRAINED)

SURFACES = {
    surface.name: surface
    for surface in (
        Surface("plastic", _RUBBER, _TABLE),
        Surface("paper", _RUBBER, _TABLE),
        Surface("vinyl", _RUBBER, Friction(0.45, "estimate: a film clings a little more than the paper below it")),
        Surface(
            "acrylic", _RUBBER, Friction(0.45, "estimate: handbooks have .4 to .5 on dry steel, and nothing on wood")
        ),
        Surface(
            "wood",
            Friction(0.9, "S. A. Hill, Coefficients of Friction (2022): shoes on wood, .9 at rest"),
            Friction(0.45, "estimate: wood on wood has .5 at rest, .3 sliding (the same page)"),
        ),
    )
}
"""What objects are covered with."""


@dataclass(frozen=True)
class TableObject:
    """An object of the paper's Table III."""

    spec: ObjectSpec
    """The object."""
    successes: int
    """Of the paper's policy in 15 tries."""


@dataclass(frozen=True)
class Baselines:
    """The paper's baselines with the default object, of 15 tries."""

    fixed_limits: int | None
    """Limits of the residual at zeta* from the first step of training; None: not tried."""
    operational_space: int
    """Operational space control."""


TRIES = 15
BASELINES = {"card": Baselines(11, 2), "bump": Baselines(None, 1), "wall": Baselines(None, 0)}


def _row(domain: Task, name: str, grams: float, surface: str, successes: int, **soft) -> TableObject:
    size = tuple(2 * half for half in domain.half_size)
    return TableObject(ObjectSpec(name, domain.name, size, grams / 1e3, SURFACES[surface], **soft), successes)


def _default(domain: Task, surface: str, successes: int) -> TableObject:
    """The domain's own object; its mass is density times volume, which the paper rounds to grams."""
    row = _row(domain, "default", 1e3 * domain.mass, surface, successes)
    return replace(row, spec=replace(row.spec, mass=domain.mass))


ROWS = (
    _default(CARD, "plastic", 13),
    _row(CARD, "wrapped", 8, "vinyl", 7),
    _row(CARD, "acrylic", 16, "acrylic", 11),
    _row(CARD, "wood", 8, "wood", 14),
    _row(CARD, "credit_card", 5, "plastic", 14),
    # A pack of tissues: 10 N on all of it take 1 mm of its 5.
    _row(CARD, "tissue", 1, "paper", 14, compliance=Softness(1e4, 0.001)),
    # Chips in a bag: most of the weight, free to gather at a side, little of it upwards.
    _row(CARD, "chocolate_chips", 9, "vinyl", 13, contents=Contents(0.007, (0.006, 0.006, 0.0), 0.4)),
    _default(BUMP, "paper", 13),
    _row(BUMP, "wrapped", 146, "vinyl", 11),
    _row(BUMP, "dense", 223, "paper", 15),
    _row(BUMP, "wood", 381, "paper", 12),
    _row(BUMP, "painted_wood", 381, "wood", 10),
    # Foam of 20 kPa: modulus times area over length.
    _row(BUMP, "sponge", 30, "paper", 10, compliance=Softness(1800.0, 0.008)),
    # A carton that gives way to the nappies behind it.
    _row(BUMP, "diaper_box", 102, "paper", 8, compliance=Softness(6000.0, 0.004)),
    _default(WALL, "paper", 13),
    _row(WALL, "wrapped", 38, "vinyl", 13),
    _row(WALL, "dense", 62, "paper", 13),
    _row(WALL, "wood", 97, "paper", 9),
    _row(WALL, "painted_wood", 97, "wood", 9),
    _row(WALL, "sponge", 5, "paper", 15, compliance=Softness(500.0, 0.005)),
    # A soft packet whose wet block slides along its length.
    _row(
        WALL,
        "water_tissue_box",
        138,
        "paper",
        3,
        compliance=Softness(2000.0, 0.004),
        contents=Contents(0.12, (0.0, 0.0, 0.008), 0.3),
    ),
)
"""In the paper's order."""


def rows_of(domain: str) -> dict[str, TableObject]:
    """A domain's rows by name. Raises ValueError for an unknown domain."""
    if domain not in DOMAINS:
        raise ValueError(f"domain: expected one of {', '.join(DOMAINS)}, got {domain!r}")
    return {row.spec.name: row for row in ROWS if row.spec.domain == domain}

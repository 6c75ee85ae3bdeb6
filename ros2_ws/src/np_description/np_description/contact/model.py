"""Contact: which shapes, how rough, how hard, by which friction law. One definition for every engine, for training and for the bench.

Three definitions stand side by side. `SOFT` is MuJoCo's default: a fingertip sinks millimetres into wood. `HARD` is as hard as a
simulator steps at the same rate. `Task.contact` is the one in which a domain's released weights were trained. `STEADY` is HARD for what
is to be compared with a recording.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from np_description.hand import FLAT_HAND, ROUND_HAND, HandShapes


@dataclass(frozen=True)
class Compliance:
    """A contact's spring and damper (MuJoCo's solref and solimp)."""

    time_constant: float
    """For the masses that meet, s."""
    damping_ratio: float
    """For the masses that meet."""
    impedance: tuple[float, float]
    """Share of the constraint force at first touch, and from depth `width` on."""
    width: float
    """m."""

    @property
    def solref(self) -> tuple[float, float]:
        """MuJoCo's reference: time constant s, damping ratio."""
        return self.time_constant, self.damping_ratio

    @property
    def solimp(self) -> tuple[float, float, float, float, float]:
        """MuJoCo's impedance: from, to, width m, midpoint and power of the transition."""
        return *self.impedance, self.width, 0.5, 2.0


@dataclass(frozen=True)
class ContactModel:
    """Friction and compliance of the object's contacts, and the solver's settings."""

    name: str
    """As in contracts of weights."""
    table: float
    """Coulomb coefficient with table and obstacles."""
    finger: float
    """Coulomb coefficient with the fingertips."""
    housing: float
    """Coulomb coefficient with the hand."""
    links: float
    """Coulomb coefficient with the arm."""
    hard: Compliance
    """Compliance of all but rubber."""
    rubber: Compliance
    """Compliance of the fingertips."""
    elliptic: bool
    """An elliptic friction cone; otherwise a pyramid, which has less friction along its diagonals."""
    impratio: float
    """Stiffness of friction relative to the normal direction, against creep."""
    iterations: int = 20
    """Of the solver, at most."""
    line_search: int = 20
    """Iterations of its line search, at most."""
    hand: HandShapes = FLAT_HAND
    """The hand's shapes that touch."""

    def as_dict(self) -> dict:
        """Its numbers, for what is to be compared or written down."""
        return asdict(self)


RUBBER_STIFFNESS = 4e4  # N/m: a thin pad's; what `HARD.rubber` comes to, and an engine with springs of its own uses
OBJECT_FRICTION = 0.1  # lower than every partner's, so that each partner decides: MuJoCo takes the larger of two
TORSION, ROLLING = 0.005, 1e-4  # m: MuJoCo's defaults; boxes have several points of contact, which do without

MUJOCO_DEFAULT = Compliance(0.02, 1.0, (0.9, 0.95), 0.001)

SOFT = ContactModel(
    "soft",
    table=0.4,  # plastic or paper on wood
    finger=1.0,  # rubber
    housing=1.0,  # MuJoCo's default, and too much for painted metal
    links=1.0,
    hard=MUJOCO_DEFAULT,
    rubber=MUJOCO_DEFAULT,
    elliptic=False,
    impratio=1.0,
    hand=ROUND_HAND,
)

HARD = ContactModel(
    "hard",
    table=0.4,
    finger=1.0,
    housing=0.25,  # painted metal on paper or plastic (handbook values .2 to .3)
    links=0.25,
    hard=Compliance(
        0.006, 1.0, (0.97, 0.995), 0.0005
    ),  # harder ones chatter at steps of 2 to 2.5 ms, and slide unevenly
    rubber=Compliance(0.006, 1.0, (0.97, 0.995), 0.0005),  # gives way by .5 mm at 20 N: RUBBER_STIFFNESS
    elliptic=True,
    impratio=10.0,
    # With 20 the solver ends before friction has settled, and a box that is pulled at .9 of its friction slides at 14 mm/s.
    line_search=50,
)

_GROWING = Compliance(0.006, 1.0, (0.3, 0.995), 0.0002)
STEADY = replace(HARD, name="steady", hard=_GROWING, rubber=_GROWING, impratio=50.0)
"""HARD, but for a force that grows with the depth from the first touch on. Where nearly all of it acts at once (.97), a pressed tip that moves is
thrown off, and touches in .4 of the steps what rubber stays on: it hops, and where it takes an object is chance. As hard as HARD at 20 N (.49 mm);
friction is stiffer, since a softer first touch would let it creep (.04 mm/s at .9 of the load that slides)."""

CONTACTS = {model.name: model for model in (SOFT, HARD, STEADY)}


def find_contact(name: str) -> ContactModel:
    """The definition called `name`. Raises ValueError with the known names."""
    if name not in CONTACTS:
        raise ValueError(f"contact: expected one of {', '.join(CONTACTS)}, got {name!r}")
    return CONTACTS[name]

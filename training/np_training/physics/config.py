"""How the batched simulator can be set up. Needs no simulator: commands read their options with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim2real.effects.patch import Patch

from np_description.contact.model import HARD, SOFT, STEADY, Compliance, ContactModel
from np_description.domains import Task
from np_training.physics.supported_effects import check_supported

LARGEST = 1.2  # times its own size that an object may have


@dataclass(frozen=True)
class PhysicsConfig:
    """A scene in many worlds."""

    timestep: float = 0.005
    """Of the physics, s."""
    substeps: int = 20
    """Physics steps a policy period (10 Hz)."""
    contacts: int = 32
    """Room for contacts, a world on average: all worlds share one store."""
    constraints: int = 192  # 112 are too few for a card that stands on patches under two flat fingers
    """Room for constraints of each world."""
    iterations: int = 8
    """Of the contact solver, at most."""
    ls_iterations: int = 10
    """Of its line search, at most."""
    effects: Patch = Patch()
    """What the arm has besides the nominal one (np_training.physics.supported_effects)."""
    contact: ContactModel = SOFT
    """How rough and how hard everything is."""
    supports: bool = False
    """Whether the object stands on patches, for `VariedModel.support`."""
    resizes: bool = False
    """Whether it may become larger, up to LARGEST times, for `VariedModel.resize`."""
    fused: bool = True
    """Whether np_training.physics.fused_solver solves the constraints where it fits, else MuJoCo Warp's own solver."""

    def __post_init__(self) -> None:
        check_supported(self.effects)


FIRM = replace(
    HARD,
    name="firm",
    hard=Compliance(0.01, 1.0, (0.95, 0.99), 0.0005),
    rubber=Compliance(0.01, 1.0, (0.95, 0.99), 0.0005),
    elliptic=False,
)
"""As hard as steps of 5 ms allow, to learn in three times as fast before the hard ones: nothing is measured in it."""

STEPPING = {
    "soft": (SOFT, dict(timestep=0.005, substeps=20, iterations=8, ls_iterations=10)),
    "firm": (FIRM, dict(timestep=0.005, substeps=20, iterations=8, ls_iterations=20)),
    # Hard contacts are stable with steps of 2.5 ms, and their friction needs the line search (np_description.contact).
    "hard": (HARD, dict(timestep=0.0025, substeps=40, iterations=16, ls_iterations=50)),
    # The same to learn in: MuJoCo then holds time constants at two steps, 8 ms, and a policy does as well there as in "hard".
    "swift": (HARD, dict(timestep=0.004, substeps=25, iterations=8, ls_iterations=20)),
    "steady": (STEADY, dict(timestep=0.0025, substeps=40, iterations=16, ls_iterations=50)),
    "growing": (STEADY, dict(timestep=0.004, substeps=25, iterations=8, ls_iterations=20)),
}

LEARNED_IN = {SOFT.name: "soft", HARD.name: "swift", STEADY.name: "growing"}
"""How the contacts of a domain are stepped where its policies are learned, by the definition's name."""


def physics_for(contact: str, **options) -> PhysicsConfig:
    """The physics in which a contact definition is stepped; options: further fields. Raises ValueError for an unknown name."""
    if contact not in STEPPING:
        raise ValueError(f"contact: expected one of {', '.join(STEPPING)}, got {contact!r}")
    model, stepping = STEPPING[contact]
    return PhysicsConfig(contact=model, **{**stepping, **options})


def check_trainable(domain: Task) -> None:
    """Raises ValueError for an object that is not rigid: a world has no room for its parts."""
    if domain.object is not None and not domain.object.is_rigid:
        raise ValueError(f"object: training moves rigid ones, got {domain.object.name}, which has moving parts")

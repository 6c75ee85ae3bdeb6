"""The effects of data/gap_effects.yaml on the arm's side: what each one changes, and how that shows.

One module for each module of the catalogue; `base` says what an effect is.
"""

from __future__ import annotations

from np_diagnosis.effects import friction, rigid_body, sensing, software, timing, torque_loop, transmission
from np_diagnosis.effects.base import Context, Effect, Parameter, catalogue, equivalence_classes

__all__ = ["Context", "Effect", "Parameter", "catalogue", "equivalence_classes", "all_effects"]

MODULES = (friction, transmission, torque_loop, software, timing, rigid_body, sensing)


def all_effects(context: Context) -> list[Effect]:
    """Every effect that this recording could show, variants included."""
    return [effect for module in MODULES for effect in module.effects(context)]

"""Changes of the rigid-body model that several effects share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_description.panda import PandaModel
from sim2real.effects.effect import ARM


def joint_rows(panda: PandaModel, component: str) -> slice | int:
    """Where in an array by joint a component is: all of them for the arm."""
    return slice(None) if component == ARM else panda.joints.index(component)


def add_to_joints(panda: PandaModel, field: str, component: str, change: float) -> PandaModel:
    """The arm with `change` added to a number by joint. Less than none is the caller's to prevent (`Patch.panda`)."""
    values = np.array(getattr(panda, field))
    values[joint_rows(panda, component)] += change
    return replace(panda, **{field: values})


def link_name(panda: PandaModel, component: str) -> str:
    """The link that a joint moves."""
    return f"link{panda.joints.index(component) + 1}"

"""One record an effect of the scene: what a patch may say of contact, object and table, and what it changes in a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from np_description.scene_change import SceneChange
from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Catalogued, Given, Seen


class Whose(StrEnum):
    """What an effect of the scene belongs to."""

    CONTACT = "contact"
    OBJECT = "object"
    ENVIRONMENT = "environment"


@dataclass(frozen=True, eq=False)
class SceneRecord(Catalogued):
    """An effect of the scene. change: the scene with it, given the scene without it and the quantities; in_training: whether the training,
    whose tasks are drawn where the domain says, has it too."""

    id: str
    part: Whose
    quantities: tuple[Quantity, ...]
    seen: Seen
    said: str
    change: Callable[[SceneChange, Given], SceneChange]
    in_training: bool = True

    @property
    def carriers(self) -> tuple[str, ...]:
        """Who carries it."""
        return ("bridge", "training") if self.in_training else ("bridge",)

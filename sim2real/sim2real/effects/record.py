"""One record an effect: what a patch may say of it, what it changes in a simulator, how it shows in a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from np_description.panda import PandaModel
from sim2real.effects.behaviour import OnDrive, OnSensors, Resistance, Values
from sim2real.effects.catalogue import catalogue
from sim2real.effects.evidence import Context
from sim2real.effects.signature import Signature
from sim2real.effects.weight import Weight

ARM = "arm"


class Place(StrEnum):
    """Where an effect may sit. JOINT: at a joint, or at "arm" for all of them. LINK: the link that a joint moves. ARM: the
    whole arm."""

    JOINT = "joint"
    LINK = "link"
    ARM = "arm"


@dataclass(frozen=True)
class Quantity:
    """A number that a patch gives for an effect, with the range in which it may lie: wider than what the doctor looks for, since
    the fits of others put much into it."""

    name: str
    unit: str
    lower: float
    upper: float


@dataclass(frozen=True)
class Visible:
    """The declared magnitude from which on the excitation suite can show an effect at all: size 1 of the blind test.

    limit: one number for the arm, or one a joint (base to wrist), in `unit`. joints: where it is drawn (1..7), empty for an
    effect of the arm. largest: multiple of the limit up to which the size is physical. The limits follow from the torque that
    stands out of the sensor noise (0.06 .. 0.015 Nm, base to wrist) over the suite's speeds, loads and accelerations.
    """

    unit: str
    limit: float | tuple[float, ...]
    joints: tuple[int, ...] = ()
    largest: float = 10.0


PandaChange = Callable[[PandaModel, str, Mapping[str, float]], PandaModel]


@dataclass(frozen=True, eq=False)
class EffectRecord:
    """An effect.

    quantities: what a patch gives, changes against the nominal arm unless the catalogue says otherwise. signatures: every way
    it could show in a recording. panda: change of the rigid-body model, given the component and the quantities. weight:
    change of what gravity leaves on the joints. drive, joints, sensors: what it does behind the torque interface, on the
    joints, to the measurements. shows_in_motion: whether a simulated motion tells its size, so that it can be fitted there.
    numpy_only: its hooks take NumPy's arrays alone (sim2real.effects.arrays): training carries it as well, at the price of a copy to
    the processor every period. text: its row of the catalogue where data/gap_effects.yaml has none. said: what it is, as
    half a sentence with the quantities in braces (`sim2real.effects.saying`), "" for its name and its numbers.
    """

    id: str
    place: Place
    quantities: tuple[Quantity, ...]
    signatures: Callable[[Context], list[Signature]]
    visible: Visible | None = None
    panda: PandaChange | None = None
    weight: Callable[[Weight, str, Mapping[str, float]], Weight] | None = None
    drive: OnDrive | None = None
    joints: Callable[[Values], Resistance] | None = None
    sensors: OnSensors | None = None
    shows_in_motion: bool = True
    numpy_only: bool = False
    always: Callable[[Context], list[Signature]] | None = None
    text: Mapping[str, str] | None = None
    said: str = ""

    @property
    def module(self) -> str:
        """The part of the robot it belongs to, as the catalogue has it."""
        return self.entry["module"]

    @property
    def entry(self) -> Mapping[str, str]:
        """Its row of the catalogue: module, model, panda_magnitude, signature, exciting_experiment.

        Raises KeyError where neither the catalogue nor the record has one.
        """
        return self.text or catalogue()[self.id]

    @property
    def is_simulated(self) -> bool:
        """Whether the simulated arm of the bridge and of the doctor has it at all."""
        return any((self.panda, self.weight, self.drive, self.joints, self.sensors))

    @property
    def is_refitted(self) -> bool:
        """Whether its size can be fitted in forward simulation."""
        return self.is_simulated and self.shows_in_motion

    @property
    def carriers(self) -> tuple[str, ...]:
        """Who carries it: bridge, forward (the doctor's forward model), training."""
        named = {"bridge": self.is_simulated, "forward": self.is_refitted, "training": self.is_simulated}
        return tuple(name for name, carries in named.items() if carries)

"""One effect: what a patch may contain of it, what it changes in a simulator, and how it shows in a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from np_description.camera import Camera
from np_description.panda import PandaModel
from np_description.scene_change import SceneChange
from sim2real.effects.catalogue import catalogue
from sim2real.effects.evidence import Context
from sim2real.effects.gravity import GravityModel
from sim2real.effects.hooks import DriveHook, HookContext, ResistanceFunction, SensorHook
from sim2real.effects.regressor import EffectRegressor

ARM = "arm"


class EffectTarget(StrEnum):
    """What an effect changes. Of an arm: a joint (or, at "arm", all of them), the link that a joint moves, or the whole arm."""

    JOINT = "joint"
    LINK = "link"
    ARM = "arm"
    CAMERA = "camera"
    KEYPOINTS = "keypoints"
    CONTACT = "contact"
    OBJECT = "object"
    ENVIRONMENT = "environment"


ARM_TARGETS = (EffectTarget.JOINT, EffectTarget.LINK, EffectTarget.ARM)
CAMERA_TARGETS = (EffectTarget.CAMERA, EffectTarget.KEYPOINTS)
SCENE_TARGETS = (EffectTarget.CONTACT, EffectTarget.OBJECT, EffectTarget.ENVIRONMENT)


@dataclass(frozen=True)
class Quantity:
    """A number that a patch gives for an effect, mostly a change against the nominal simulator."""

    name: str
    """Its name in a patch."""
    unit: str
    """SI; px in images."""
    lower: float
    """Physical range, wider than that of the diagnosis: other estimators put more into one effect."""
    upper: float
    """Likewise."""

    @property
    def is_magnitude(self) -> bool:
        """Whether zero is its least value: a width, a time, a mass."""
        return self.lower == 0.0


@dataclass(frozen=True)
class DetectionLimit:
    """The declared magnitude from which on the excitation or task suite can show an effect: size 1 of the blind test.

    Those of the arm follow from the torque that stands out of the sensor noise (0.06 .. 0.015 Nm, base to wrist) over the
    suite's speeds, loads and accelerations.
    """

    unit: str
    """Unit of `limit`."""
    limit: float | tuple[float, ...]
    """One number, or one a joint, base to wrist."""
    joints: tuple[int, ...] = ()
    """Joints (1..7) at which the blind test draws it; empty for an effect of no single joint."""
    largest: float = 10.0
    """Multiple of the limit up to which the size is physical."""


QuantityValues = Mapping[str, float]
"""Values of an effect's quantities, every one by its name."""


@dataclass(frozen=True)
class Disturbance:
    """What a random effect of the keypoints gets, once an image; in training it is of n images, with tensors (n, ...)."""

    quantities: QuantityValues
    """The effect's quantities in the patch."""
    rng: np.random.Generator
    """Generator of this image alone, so that the same recording has the same draws."""
    last: np.ndarray
    """(8, 2) px, the disturbance of the image before."""


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect of the arm, of the camera with what finds keypoints, or of the scene, by its `target`.

    A hook that is None is not needed. Hooks of an arm take one arm, or S side by side (`hooks`).
    """

    id: str
    """Its name in patches, reports and the catalogue."""
    target: EffectTarget
    """What it changes."""
    quantities: tuple[Quantity, ...]
    """What a patch may give for it."""
    regressors: Callable[[Context], list[EffectRegressor]] = lambda context: []
    """Every way in which it can show in a recording of the arm."""
    detection_limit: DetectionLimit | None = None
    """From which size on it shows; None: it is not drawn in the blind test."""
    sentence_template: str = ""
    """Half a sentence with the quantities in braces (`sentences`); "": its name and its numbers."""
    special_cases: tuple[str, ...] = ()
    """Ids of simpler effects of the same target that it can imitate: they do not contradict it, and are preferred."""
    catalogue_row: Mapping[str, str] | None = None
    """Its row of the catalogue where data/gap_effects.yaml has none."""

    modify_rigid_body: Callable[[PandaModel, str, QuantityValues], PandaModel] | None = None
    """(model, component, quantities) -> rigid-body model of the arm."""
    gravity_error: Callable[[GravityModel, str, QuantityValues], GravityModel] | None = None
    """(model, component, quantities) -> what gravity leaves on the joints."""
    drive: DriveHook | None = None
    """What the drives make of a commanded torque."""
    joints: Callable[[HookContext], ResistanceFunction] | None = None
    """Torque on the joints against their motion."""
    sensors: SensorHook | None = None
    """What the sensors make of angle, speed and torque."""
    shows_in_motion: bool = True
    """Whether a simulated motion determines its size, so that it can be refitted there."""
    numpy_only: bool = False
    """Whether its hooks take NumPy arrays alone; training then copies to the processor every period."""
    reference_regressors: Callable[[Context], list[EffectRegressor]] | None = None
    """What earlier recordings of the same arm already show of it."""

    camera_pose: Callable[[Camera, QuantityValues], Camera] | None = None
    """(nominal camera, quantities) -> true camera."""
    image_age: Callable[[QuantityValues, float], float] | None = None
    """(quantities, stamp s) -> s by which the scene in an image is older than its stamp."""
    readout_time: Callable[[QuantityValues], float] | None = None
    """s from the first row of an image to the last; its stamp is that of the middle."""
    exposure: Callable[[QuantityValues], float] | None = None
    """s over which an image is collected, up to its moment."""
    lens: Callable[[np.ndarray, Camera, QuantityValues], np.ndarray] | None = None
    """Pixels (..., 2) of the ideal lens -> pixels of this one."""
    repeats: Callable[[QuantityValues], float] | None = None
    """Fraction of the images that show the one before again."""
    move_keypoints: Callable[[Disturbance], np.ndarray] | None = None
    """px (8, 2) by which keypoints are off in an image."""
    has_memory: bool = False
    """Whether `move_keypoints` gets its result of the image before as `Disturbance.last`."""

    modify_scene: Callable[[SceneChange, QuantityValues], SceneChange] | None = None
    """(scene without it, quantities) -> scene with it."""
    in_training: bool = True
    """Whether training, whose tasks are drawn by the domain, has this effect of the scene too."""

    @property
    def module(self) -> str:
        """The part of the robot that reports name for it."""
        return self.entry["module"]

    @property
    def entry(self) -> Mapping[str, str]:
        """Its row of the catalogue: module, model, panda_magnitude, signature, exciting_experiment.

        Raises KeyError where neither the catalogue nor the effect has one.
        """
        return self.catalogue_row or catalogue()[self.id]

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated arm has it at all."""
        return any((self.modify_rigid_body, self.gravity_error, self.drive, self.joints, self.sensors))

    @property
    def is_refitted(self) -> bool:
        """Whether its size can be fitted in forward simulation."""
        return self.is_simulated and self.shows_in_motion

    @property
    def supported_in(self) -> tuple[str, ...]:
        """Who simulates it: bridge, forward (the forward model of the diagnosis), images, keypoints (of `keypoint_oracle`), training."""
        if self.target in SCENE_TARGETS:
            return ("bridge", "training") if self.in_training else ("bridge",)
        if self.target in CAMERA_TARGETS:  # training draws nothing that happens within an image, or to whole images
            images = ("images",) if any((self.camera_pose, self.image_age, self.lens, self.repeats)) else ()
            learned = any((self.camera_pose, self.image_age, self.lens, self.move_keypoints))
            return (*images, "keypoints", *(("training",) if learned else ()))
        named = {"bridge": self.is_simulated, "forward": self.is_refitted, "training": self.is_simulated}
        return tuple(name for name, carries in named.items() if carries)

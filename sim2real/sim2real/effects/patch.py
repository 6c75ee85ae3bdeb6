"""The gap as data: `patch.yaml`, which the diagnosis writes and simulators load.

A patch is a list of effects (ids of `EFFECTS`), each at a component with its quantities, mostly changes against the nominal
arm. What a rigid-body simulator has a number for becomes a `PandaModel`; `arm_effects.ArmEffects` gives the rest as a model
of drive, joints and sensors that is stepped with the physics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml

from np_description.panda import NOMINAL, PANDA, PandaModel
from np_description.scene_change import SceneChange
from sim2real.effects.effect import ARM, ARM_TARGETS, Effect, EffectTarget
from sim2real.effects.registry import ARM_EFFECTS, CAMERA_EFFECTS, EFFECTS, SCENE_EFFECTS

LEAST_ARMATURE = 1e-3  # kg m^2, below which a simulator's steps would have to be shorter


@dataclass(frozen=True)
class PatchEffect:
    """One effect of a patch."""

    effect: str
    """Its id."""
    component: str
    """A joint's name, "arm", or the part of camera or scene."""
    parameters: Mapping[str, float]
    """Values by quantity, SI units, px in images."""

    @property
    def definition(self) -> Effect:
        """The effect that it is."""
        return EFFECTS[self.effect]

    def get(self, name: str, default: float = 0.0) -> float:
        """A parameter, or its default."""
        return float(self.parameters.get(name, default))

    @property
    def values(self) -> dict[str, float]:
        """Every quantity of the effect by name, 0 where the patch does not contain it."""
        return {quantity.name: self.get(quantity.name) for quantity in self.definition.quantities}


@dataclass(frozen=True)
class Patch:
    """Effects that are in force together."""

    effects: tuple[PatchEffect, ...] = field(default=())
    """In the order of the file."""

    @property
    def arm(self) -> Patch:
        """Those of the arm."""
        return Patch(tuple(e for e in self.effects if e.effect in ARM_EFFECTS))

    @property
    def camera(self) -> Patch:
        """Those of camera and keypoints."""
        return Patch(tuple(e for e in self.effects if e.effect in CAMERA_EFFECTS))

    @property
    def scene(self) -> Patch:
        """Those of contact, object and table."""
        return Patch(tuple(e for e in self.effects if e.effect in SCENE_EFFECTS))

    def scene_change(self) -> SceneChange:
        """The change of a simulator's scene against the nominal one."""
        change = SceneChange()
        for e in self.scene.effects:
            change = e.definition.modify_scene(change, e.values)
        return change

    def of(self, effect: str) -> list[PatchEffect]:
        """The effects of this id."""
        return [e for e in self.effects if e.effect == effect]

    def per_joint(self, effect: str, parameter: str) -> np.ndarray:
        """A parameter by joint (7,), 0 where the effect is not; what sits at the arm is at every joint."""
        values = np.zeros(len(NOMINAL.joints))
        for e in self.of(effect):
            rows = slice(None) if e.component == ARM else NOMINAL.joints.index(e.component)
            values[rows] += e.get(parameter)
        return values

    def panda(self, nominal: PandaModel = NOMINAL) -> PandaModel:
        """The arm with all that a rigid-body simulator has a number for; none of them below what is physical."""
        arm = self._requested(nominal)
        return replace(
            arm,
            frictionloss=np.maximum(arm.frictionloss, 0.0),
            damping=np.maximum(arm.damping, 0.0),
            armature=np.maximum(arm.armature, LEAST_ARMATURE),
        )

    def list_clipped_parameters(self) -> list[str]:
        """Where the patch requests less than is physical: a line for each, with effects, joint, and what is in force."""
        requested, effective = self._requested(NOMINAL), self.panda()
        lines = []
        for name, unit in (("frictionloss", "Nm"), ("damping", "Nm s/rad"), ("armature", "kg m^2")):
            wanted, has = getattr(requested, name), getattr(effective, name)
            for j in np.flatnonzero(wanted < has):
                joint = NOMINAL.joints[j]
                causes = [
                    e.effect
                    for e in self.arm.effects
                    if e.component in (ARM, joint)
                    and getattr(Patch((e,))._requested(NOMINAL), name)[j] < getattr(NOMINAL, name)[j]
                ]
                lines.append(
                    f"{', '.join(causes)} at {joint}: asks for a {name} of {wanted[j]:.4g} {unit}, in force is {has[j]:.4g}"
                )
        return lines

    def _requested(self, nominal: PandaModel) -> PandaModel:
        """The arm with the sums of all changes, physical or not."""
        arm = nominal
        for e in self.arm.effects:
            if e.definition.modify_rigid_body is not None:
                arm = e.definition.modify_rigid_body(arm, e.component, e.values)
        return arm


def load_patch(path: str | Path) -> Patch:
    """A patch from its YAML file. Raises ValueError naming the entry that is wrong."""
    try:
        raw = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ValueError(f"effects {path}: expected a patch.yaml, got: {' '.join(str(error).split())}") from error
    if not isinstance(raw, Mapping) or not isinstance(raw.get("effects"), list):
        raise ValueError(f"effects {path}: expected a mapping with the list 'effects', got {raw!r:.80}")
    if raw.get("arm", PANDA) != PANDA:
        raise ValueError(
            f"effects {path}: expected a patch of the {PANDA}, which is simulated here, got one of {raw['arm']!r}"
        )
    return Patch(
        tuple(_read_effect(entry, f"effects {path}, entry {number}") for number, entry in enumerate(raw["effects"]))
    )


def _read_effect(entry: object, place: str) -> PatchEffect:
    if not isinstance(entry, Mapping) or not {"effect", "component", "parameters"} <= set(entry):
        raise ValueError(f"{place}: expected effect, component and parameters, got {entry!r:.80}")
    effect = EFFECTS.get(entry["effect"])
    if effect is None:
        raise ValueError(
            f"{place}: expected an effect of the arm ({', '.join(ARM_EFFECTS)}), of the view ({', '.join(CAMERA_EFFECTS)}) or of the "
            f"scene ({', '.join(SCENE_EFFECTS)}), got {entry['effect']!r}"
        )
    if effect.target not in ARM_TARGETS:
        if entry["component"] != effect.target:
            raise ValueError(
                f"{place}: expected '{effect.target}' as component of {effect.id}, got {entry['component']!r}"
            )
    elif entry["component"] not in (ARM, *NOMINAL.joints):
        raise ValueError(f"{place}: expected 'arm' or a joint as component, got {entry['component']!r}")
    elif effect.target is EffectTarget.ARM and entry["component"] != ARM:
        raise ValueError(f"{place}: expected 'arm' as component of {effect.id}, got {entry['component']!r}")
    elif effect.target is EffectTarget.LINK and entry["component"] == ARM:
        raise ValueError(f"{place}: expected the joint that moves the link as component of {effect.id}, got 'arm'")
    known, values = {quantity.name: quantity for quantity in effect.quantities}, {}
    for name, value in dict(entry["parameters"]).items():
        if name not in known or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise ValueError(f"{place}: expected finite numbers for {', '.join(known)}; got {name}: {value!r}")
        q = known[name]
        if not q.lower <= value <= q.upper:
            raise ValueError(
                f"{place}: expected {name} of {effect.id} from {q.lower:g} to {q.upper:g} {q.unit}, got {value!r}"
            )
        values[name] = float(value)
    return PatchEffect(effect.id, entry["component"], values)


def dump_patch(patch: Patch, arm: str = PANDA) -> str:
    """The YAML text that `load_patch` reads, where the arm is the Panda; of another arm it is a list to read."""
    entries = [
        {"effect": e.effect, "component": e.component, "parameters": {k: float(v) for k, v in e.parameters.items()}}
        for e in patch.effects
    ]
    return yaml.safe_dump({"arm": arm, "effects": entries}, sort_keys=False)

"""The gap as data: `patch.yaml`, which the doctor writes and simulators load.

A patch is a list of effects (ids of np_diagnosis/data/gap_effects.yaml), each at a component with its parameters
as changes against the nominal arm. What MuJoCo has a field for becomes a `PandaModel` (friction, damping,
armature, inertia); `arm_effects` gives the rest as a model of drive and sensors that is stepped with the physics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml

from np_description.panda import NOMINAL, Inertial, PandaModel

ARM = "arm"

# effect id -> parameters it may have; the first is required.
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "coulomb_friction": ("level",),
    "asymmetric_coulomb_friction": ("level_positive", "level_negative"),
    "viscous_friction": ("coefficient",),
    "asymmetric_viscous_friction": ("coefficient_positive", "coefficient_negative"),
    "stribeck_friction": ("breakaway", "speed"),
    "load_dependent_friction": ("coefficient",),
    "presliding_friction": ("level", "stroke"),
    "armature": ("inertia",),
    "cable_torque": ("stiffness", "offset"),
    "torque_ripple": ("sine", "cosine", "order"),
    "thermal_drift": ("change", "duration"),
    "backlash": ("half_play",),
    "transmission_hysteresis": ("width", "stroke"),
    "joint_elasticity": ("compliance", "damping_time"),
    "torque_scale": ("scale",),
    "torque_offset": ("offset",),
    "actuator_lag": ("time_constant",),
    "torque_saturation": ("limit",),
    "torque_rate_limit": ("limit",),
    "stiffness_gain_error": ("relative",),
    "damping_gain_error": ("relative",),
    "controller_mismatch": ("time_constant",),
    "command_delay": ("delay",),
    "measurement_delay": ("delay",),
    "packet_loss": ("share",),
    "payload": ("mass",),
    "link_com": ("moment_x", "moment_y", "moment_z"),
    "link_inertia": ("scale",),
    "gravity_compensation_error": ("scale",),
    "base_tilt": ("roll", "pitch"),
    "encoder_bias": ("bias",),
    "encoder_quantisation": ("step",),
    "torque_sensor_error": ("gain", "offset"),
}


@dataclass(frozen=True)
class PatchEffect:
    """One effect: id, component (a joint's name or "arm"), parameters in SI units."""

    effect: str
    component: str
    parameters: Mapping[str, float]

    def get(self, name: str, default: float = 0.0) -> float:
        """A parameter, or its default."""
        return float(self.parameters.get(name, default))


@dataclass(frozen=True)
class Patch:
    """Effects that are in force together."""

    effects: tuple[PatchEffect, ...] = field(default=())

    def of(self, effect: str) -> list[PatchEffect]:
        """The effects of this id."""
        return [e for e in self.effects if e.effect == effect]

    def per_joint(self, effect: str, parameter: str, joints: Sequence[str] = NOMINAL.joints) -> np.ndarray:
        """A parameter by joint (k,), 0 where the effect is not; what sits at the arm is at every joint."""
        values = np.zeros(len(joints))
        for e in self.of(effect):
            rows = slice(None) if e.component == ARM else joints.index(e.component)
            values[rows] += e.get(parameter)
        return values

    def panda(self, nominal: PandaModel = NOMINAL) -> PandaModel:
        """The arm with all that a rigid-body simulator has a number for."""
        friction = nominal.frictionloss + self.per_joint("coulomb_friction", "level")
        # Half the sum slows both ways; half the difference is a constant torque, which `arm_effects` adds.
        friction = friction + 0.5 * (
            self.per_joint("asymmetric_coulomb_friction", "level_positive")
            + self.per_joint("asymmetric_coulomb_friction", "level_negative")
        )
        damping = nominal.damping + self.per_joint("viscous_friction", "coefficient")
        damping = damping + 0.5 * (
            self.per_joint("asymmetric_viscous_friction", "coefficient_positive")
            + self.per_joint("asymmetric_viscous_friction", "coefficient_negative")
        )
        armature = nominal.armature + self.per_joint("armature", "inertia")
        inertials = dict(nominal.inertials)
        for e in self.of("link_com"):
            name = f"link{nominal.joints.index(e.component) + 1}"
            body = inertials[name]
            shift = np.array([e.get(f"moment_{axis}") for axis in "xyz"]) / body.mass
            inertials[name] = replace(body, com=body.com + shift)
        for e in self.of("link_inertia"):
            name = f"link{nominal.joints.index(e.component) + 1}"
            inertials[name] = replace(inertials[name], inertia=inertials[name].inertia * (1 + e.get("scale")))
        for e in self.of("payload"):
            inertials["hand"] = _loaded(inertials["hand"], e.get("mass"), nominal.frames["hand_tcp"].position)
        return replace(
            nominal,
            frictionloss=np.maximum(friction, 0.0),
            damping=np.maximum(damping, 0.0),
            armature=np.maximum(armature, 1e-3),
            inertials=inertials,
        )


def load_patch(path: str | Path) -> Patch:
    """A patch from its YAML file. Raises ValueError naming the entry that is wrong."""
    try:
        raw = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ValueError(f"effects {path}: expected a patch.yaml, got: {error}") from error
    if not isinstance(raw, Mapping) or not isinstance(raw.get("effects"), list):
        raise ValueError(f"effects {path}: expected a mapping with the list 'effects', got {raw!r:.80}")
    found = []
    for number, entry in enumerate(raw["effects"]):
        place = f"effects {path}, entry {number}"
        if not isinstance(entry, Mapping) or not {"effect", "component", "parameters"} <= set(entry):
            raise ValueError(f"{place}: expected effect, component and parameters, got {entry!r:.80}")
        if entry["effect"] not in PARAMETERS:
            raise ValueError(
                f"{place}: expected an effect of the arm ({', '.join(PARAMETERS)}), got {entry['effect']!r}"
            )
        if entry["component"] not in (ARM, *NOMINAL.joints):
            raise ValueError(f"{place}: expected 'arm' or a joint as component, got {entry['component']!r}")
        known, values = PARAMETERS[entry["effect"]], {}
        for name, value in dict(entry["parameters"]).items():
            if name not in known or not isinstance(value, (int, float)) or not np.isfinite(value):
                raise ValueError(f"{place}: expected finite numbers for {', '.join(known)}; got {name}: {value!r}")
            values[name] = float(value)
        found.append(PatchEffect(entry["effect"], entry["component"], values))
    return Patch(tuple(found))


def dump_patch(patch: Patch) -> str:
    """The YAML text that `load_patch` reads."""
    entries = [
        {"effect": e.effect, "component": e.component, "parameters": {k: float(v) for k, v in e.parameters.items()}}
        for e in patch.effects
    ]
    return yaml.safe_dump({"arm": "panda", "effects": entries}, sort_keys=False)


def _loaded(body: Inertial, mass: float, point: np.ndarray) -> Inertial:
    """A body with a point mass kg at a point (3,) m of its frame."""
    total = body.mass + mass
    com = (body.mass * body.com + mass * point) / total
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    for m, centre in ((body.mass, body.com), (mass, point)):
        arm = centre - com
        inertia = inertia + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(total, com, np.array([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]))

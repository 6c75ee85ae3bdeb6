"""The patch of a diagnosis, applied to the nominal arm of the generator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from np_blind.arm.plant.blind_arm import LONGEST_DELAY
from np_blind.arm.plant.physics import CURVE_SPEEDS, Physics, nominal_physics
from np_blind.arm.plant.rigid_arm import tcp_in_link7
from np_blind.arm.sampling.faults import ROTOR_FIXED, soften
from np_control.impedance import STIFFNESS_MAX
from np_description.panda import JOINT_NAMES, NOMINAL

# Joint by joint: effect, {parameter of the patch: (array of Physics, factor)}; changes against what is there.
_ADDED = {
    "coulomb_friction": {"level": (("coulomb_forward", "coulomb_backward"), 1.0)},
    "asymmetric_coulomb_friction": {
        "level_positive": (("coulomb_forward",), 1.0),
        "level_negative": (("coulomb_backward",), 1.0),
    },
    "viscous_friction": {"coefficient": (("viscous_forward", "viscous_backward"), 1.0)},
    "asymmetric_viscous_friction": {
        "coefficient_positive": (("viscous_forward",), 1.0),
        "coefficient_negative": (("viscous_backward",), 1.0),
    },
    "load_dependent_friction": {"coefficient": (("load_coefficient",), 1.0)},
    "armature": {"inertia": (("armature",), 1.0)},
    "torque_scale": {"scale": (("torque_scale",), 1.0)},
    "torque_offset": {"offset": (("offset",), -1.0)},  # the drive gives it, what resists is the other way
    "torque_sensor_error": {"gain": (("sensor_scale",), 1.0), "offset": (("sensor_bias",), 1.0)},
    "encoder_bias": {"bias": (("encoder_bias",), 1.0)},
    "thermal_drift": {"change": (("thermal_drop",), -1.0)},
}
_SET = {
    "stribeck_friction": {"breakaway": "stribeck_level", "speed": "stribeck_speed"},
    "presliding_friction": {"level": "lugre_level", "stroke": "lugre_stroke"},
    "actuator_lag": {"time_constant": "lag"},
    "torque_saturation": {"limit": "saturation"},
    "torque_rate_limit": {"limit": "rate_limit"},
    "encoder_quantisation": {"step": "quantum"},
}
_OF_ARM = {
    "command_delay": {"delay": "command_delay"},
    "measurement_delay": {"delay": "measurement_delay"},
    "packet_loss": {"share": "loss"},
    "gravity_compensation_error": {"scale": "gravity_scale"},
    "controller_mismatch": {"time_constant": "filter_time"},
}


class PatchError(ValueError):
    """A patch that cannot be followed; the message gives what was expected and what came."""


def read_patch(path: Path) -> list[dict]:
    """The entries (effect, component, parameters) of a patch.yaml. Raises PatchError."""
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
        return [
            {
                "effect": str(e["effect"]),
                "component": str(e["component"]),
                "parameters": {str(k): float(v) for k, v in e["parameters"].items()},
            }
            for e in raw["effects"]
        ]
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise PatchError(
            f"{path}: expected a list 'effects' of effect, component, parameters; got {error!r}"
        ) from error


def patched_physics(patches: list[list[dict]]) -> Physics:
    """The nominal arm with each of the patches. Raises PatchError for an effect that is not known."""
    physics = nominal_physics(len(patches))
    for arm, entries in enumerate(patches):
        for entry in entries:
            _follow(physics, arm, entry["effect"], entry["component"], entry["parameters"])
    # A patch may request what no arm can be: less than no friction, no rotor, a delay from the future.
    for name in ("coulomb_forward", "coulomb_backward", "viscous_forward", "viscous_backward"):
        setattr(physics, name, np.maximum(getattr(physics, name), 0.01 if "coulomb" in name else 0.0))
    physics.armature = np.maximum(physics.armature, 0.02)
    for name in ("command_delay", "measurement_delay"):
        setattr(physics, name, np.clip(getattr(physics, name), 0.0, LONGEST_DELAY / 2))
    for name in ("lag", "filter_time", "quantum", "loss"):
        setattr(physics, name, np.maximum(getattr(physics, name), 0.0))
    return physics


def _follow(p: Physics, arm: int, effect: str, component: str, values: Mapping[str, float]) -> None:
    if component != "arm" and component not in JOINT_NAMES:
        raise PatchError(f"{effect}: expected 'arm' or a joint as component, got {component!r}")
    joints = range(7) if component == "arm" else [JOINT_NAMES.index(component)]
    if effect in _OF_ARM:
        for name, array in _OF_ARM[effect].items():
            getattr(p, array)[arm] += values[name]
    elif effect == "payload":
        p.inertials.add_point(arm, 6, values["mass"], tcp_in_link7())
    elif effect == "base_tilt":
        roll, pitch = values["roll"], values["pitch"]
        p.inertials.gravity[arm] = -p.inertials.gravity[arm, 2] * np.array(
            [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]
        )
    else:
        for j in joints:
            _follow_joint(p, arm, j, effect, values)


def _follow_joint(p: Physics, i: int, j: int, effect: str, values: Mapping[str, float]) -> None:
    if effect in _ADDED:
        for name, (arrays, factor) in _ADDED[effect].items():
            for array in arrays:
                getattr(p, array)[i, j] += factor * values.get(name, 0.0)
    elif effect in _SET:
        for name, array in _SET[effect].items():
            if name in values:
                getattr(p, array)[i, j] = values[name]
        if effect in ("torque_saturation", "torque_rate_limit"):
            p.with_weight[i, j] = 1.0 - values.get("gravity_apart", 0.0)
    elif effect == "friction_curve":
        for way, curve in (("positive", p.curve_forward), ("negative", p.curve_backward)):
            curve[i, j] += [values[f"{way}_{1e3 * v:.0f}"] for v in CURVE_SPEEDS]
    elif effect == "cable_torque":
        stiffness = values["stiffness"]
        p.cable_stiffness[i, j], p.cable_centre[i, j] = stiffness, NOMINAL.ready[j]
        p.offset[i, j] += values.get("offset", 0.0)
    elif effect == "torque_ripple":
        sine, cosine = values["sine"], values["cosine"]
        p.ripple[i, j], p.ripple_phase[i, j] = np.hypot(sine, cosine), np.arctan2(cosine, sine)
        p.ripple_order[i, j] = values["order"]
    elif effect == "joint_elasticity":
        if values["compliance"] > 1e-6:
            soften(p, i, j, 1.0 / values["compliance"])
    elif effect == "backlash":
        soften(p, i, j, ROTOR_FIXED)
        p.play[i, j] = max(values["half_play"], 0.0)
    elif effect == "transmission_hysteresis":
        soften(p, i, j, ROTOR_FIXED)
        p.hysteresis_torque[i, j], p.hysteresis_stroke[i, j] = max(values["width"], 0.0) * ROTOR_FIXED, 2e-4
    elif effect == "link_com":
        moment = np.array([values.get(f"moment_{axis}", 0.0) for axis in "xyz"])
        p.inertials.com[i, j] += moment / p.inertials.mass[i, j]
    elif effect == "link_inertia":
        p.inertials.inertia[i, j] *= max(1.0 + values["scale"], 0.05)
    elif effect == "stiffness_gain_error":
        p.stiffness_factor[i, j] += _relative(values, STIFFNESS_MAX[j])
    elif effect == "damping_gain_error":
        p.damping_factor[i, j] += _relative(values, np.sqrt(STIFFNESS_MAX[j]))
    else:
        raise PatchError(f"expected an effect of the arm, got {effect!r}")


def _relative(values: Mapping[str, float], gain: float) -> float:
    """Change of a gain as a share of it."""
    return values["relative"] if "relative" in values else values["change"] / gain

"""The faults an arm of the blind test may have: the arm-side effects of the catalogue, and what no catalogue has.

A fault has a size in multiples of its declared detection limit (`sim2real.effects.effect.DetectionLimit`). Parameters that the
key names are changes against the nominal arm; torques are those that resist the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.effect import DetectionLimit

from np_blind.arm.plant.physics import Physics
from np_blind.arm.plant.rigid_arm import nominal_inertials, tcp_in_link7
from np_control.impedance import STIFFNESS_MAX
from np_description.panda import JOINT_NAMES, NOMINAL

ARM = "arm"
ROTOR_FIXED = 1e5  # Nm/rad, of a gear in which nothing but play or hysteresis is of interest
PEAK_TORQUE = np.array([12.5, 16.0, 8.0, 10.0, 2.0, 2.5, 1.2])
PEAK_RATE = np.array([330.0, 350.0, 330.0, 300.0, 110.0, 130.0, 70.0])
"""Nm that the suite's commands pass for half a second in all, Nm/s for a tenth, on the nominal arm."""
PEAK_TOTAL = np.array([13.3, 60.5, 14.5, 28.0, 2.8, 4.5, 1.2])
HELD = np.array([0.0, 51.5, 13.8, 22.9, 2.5, 2.9, 0.1])
"""Nm that a drive passes with gravity for half a second in all, and of gravity at most."""
SPARE = (
    1.3  # times that weight, which a drive that is cut can give and the arm stays up: what moves down has to be stopped
)
HAND = np.array([0.05, 0.05, 0.07])  # m about the tool point in which a payload may be

Parameters = dict[str, tuple[float, str]]  # name: value, unit


@dataclass(frozen=True)
class Fault:
    """An effect of the catalogue at one joint (0..6), or of the arm (None), so many times its limit."""

    effect: str
    joint: int | None
    size: float

    @property
    def component(self) -> str:
        """The joint's name, or "arm"."""
        return ARM if self.joint is None else JOINT_NAMES[self.joint]


def visible(effect: str) -> DetectionLimit:
    """The declared limit of an effect: what counts as size 1."""
    return ARM_EFFECTS[effect].detection_limit


def limit_of(effect: str, joint: int | None) -> float:
    """Magnitude of size 1."""
    limit = visible(effect).limit
    return float(limit if joint is None else limit[joint])


def largest(effect: str, joint: int | None) -> float:
    """Times its limit, up to which an effect is drawn: a drive that is cut still holds the arm up."""
    most = visible(effect).largest
    if effect == "torque_saturation":
        most = min(most, (1.0 - SPARE * HELD[joint] / PEAK_TOTAL[joint]) / limit_of(effect, joint))
    return float(most)


def apply(physics: Physics, arm: int, fault: Fault, rng: np.random.Generator) -> Parameters:
    """Give an arm the fault; what exactly it got."""
    return give_effect(fault.effect, physics, arm, fault.joint, fault.size * limit_of(fault.effect, fault.joint), rng)


def give_effect(
    effect: str, physics: Physics, arm: int, joint: int | None, magnitude: float, rng: np.random.Generator
) -> Parameters:
    """Give an arm an effect of this magnitude, in the unit of its limit; what exactly it got."""
    return _FAULTS[effect](physics, arm, joint, magnitude, rng)


_FAULTS: dict[str, Callable[[Physics, int, int | None, float, np.random.Generator], Parameters]] = {}


def _fault(effect: str):
    def register(function):
        _FAULTS[effect] = function
        return function

    return register


def draw_sign(rng: np.random.Generator) -> float:
    """-1 or 1, with equal odds."""
    return float(rng.choice([-1.0, 1.0]))


def _less_or_more(present: float, change: float, rng: np.random.Generator) -> float:
    """The change, negative half of the time where at least a third of what is there would be left."""
    return -change if change < 0.66 * present and rng.random() < 0.5 else change


@_fault("coulomb_friction")
def _coulomb(p, i, j, size, rng):
    change = _less_or_more(p.coulomb_forward[i, j], size, rng)
    p.coulomb_forward[i, j] += change
    p.coulomb_backward[i, j] += change
    return {"level": (change, "Nm")}


@_fault("asymmetric_coulomb_friction")
def _asymmetric_coulomb(p, i, j, size, rng):
    sign, base = draw_sign(rng), p.coulomb_forward[i, j]
    middle = max(rng.uniform(-0.3, 0.5) * size, size - 0.8 * base)
    forward, backward = middle + sign * size, middle - sign * size
    p.coulomb_forward[i, j] += forward
    p.coulomb_backward[i, j] += backward
    return {"level_positive": (forward, "Nm"), "level_negative": (backward, "Nm")}


@_fault("viscous_friction")
def _viscous(p, i, j, size, rng):
    change = _less_or_more(p.viscous_forward[i, j], size, rng)
    p.viscous_forward[i, j] += change
    p.viscous_backward[i, j] += change
    return {"coefficient": (change, "Nms/rad")}


@_fault("asymmetric_viscous_friction")
def _asymmetric_viscous(p, i, j, size, rng):
    sign, base = draw_sign(rng), p.viscous_forward[i, j]
    middle = max(rng.uniform(-0.3, 0.5) * size, size - base)
    forward, backward = middle + sign * size, middle - sign * size
    p.viscous_forward[i, j] += forward
    p.viscous_backward[i, j] += backward
    return {"coefficient_positive": (forward, "Nms/rad"), "coefficient_negative": (backward, "Nms/rad")}


@_fault("stribeck_friction")
def _stribeck(p, i, j, size, rng):
    p.stribeck_level[i, j], p.stribeck_speed[i, j] = size, np.exp(rng.uniform(np.log(0.03), np.log(0.2)))
    return {"breakaway": (size, "Nm"), "speed": (p.stribeck_speed[i, j], "rad/s")}


@_fault("load_dependent_friction")
def _load(p, i, j, size, rng):
    p.load_coefficient[i, j] = size
    return {"coefficient": (size, "1")}


@_fault("presliding_friction")
def _presliding(p, i, j, size, rng):
    p.lugre_level[i, j], p.lugre_stroke[i, j] = size, np.exp(rng.uniform(np.log(0.003), np.log(0.03)))
    return {"level": (size, "Nm"), "stroke": (p.lugre_stroke[i, j], "rad")}


def soften(p: Physics, i: int, j: int, stiffness: float) -> None:
    """Make a gear flexible, Nm/rad."""
    p.flexible[i, j], p.stiffness[i, j] = 1.0, stiffness
    # Well enough damped that the loop, which feeds back the link's speed, is stable.
    p.gear_damping[i, j] = max(0.3 * np.sqrt(stiffness * 0.06), 8.0)


@_fault("backlash")
def _backlash(p, i, j, size, rng):
    soften(p, i, j, ROTOR_FIXED)
    p.play[i, j] = size
    return {"half_play": (size, "rad")}


@_fault("transmission_hysteresis")
def _hysteresis(p, i, j, size, rng):
    soften(p, i, j, ROTOR_FIXED)
    p.hysteresis_torque[i, j], p.hysteresis_stroke[i, j] = size * ROTOR_FIXED, rng.uniform(1e-4, 4e-4)
    return {"width": (size, "rad"), "stroke": (p.hysteresis_stroke[i, j], "rad")}


@_fault("joint_elasticity")
def _elasticity(p, i, j, size, rng):
    soften(p, i, j, 1.0 / size)
    return {"compliance": (size, "rad/Nm")}


@_fault("torque_scale")
def _scale(p, i, j, size, rng):
    p.torque_scale[i, j] = draw_sign(rng) * size
    return {"scale": (p.torque_scale[i, j], "1")}


def _gain(relative: float, gain: float, unit: str) -> Parameters:
    return {"relative": (relative, "1"), "change": (relative * gain, unit)}


@_fault("stiffness_gain_error")
def _stiffness_gain(p, i, j, size, rng):
    p.stiffness_factor[i, j] = 1.0 + draw_sign(rng) * size
    return _gain(p.stiffness_factor[i, j] - 1.0, STIFFNESS_MAX[j], "Nm/rad")


@_fault("damping_gain_error")
def _damping_gain(p, i, j, size, rng):
    p.damping_factor[i, j] = 1.0 + draw_sign(rng) * size
    return _gain(p.damping_factor[i, j] - 1.0, np.sqrt(STIFFNESS_MAX[j]), "Nms/rad")


@_fault("torque_offset")
def _offset(p, i, j, size, rng):
    offset = draw_sign(rng) * size
    p.offset[i, j] = -offset  # of the drive: it adds to the command, as in a patch and on the sim bridge
    return {"offset": (offset, "Nm")}


@_fault("torque_sensor_error")
def _sensor(p, i, j, size, rng):
    p.sensor_bias[i, j] = draw_sign(rng) * size
    p.sensor_scale[i, j] = draw_sign(rng) * rng.uniform(0.0, 0.02)
    return {"offset": (p.sensor_bias[i, j], "Nm"), "gain": (p.sensor_scale[i, j], "1")}


@_fault("command_delay")
def _command_delay(p, i, j, size, rng):
    p.command_delay[i] += size
    return {"delay": (float(p.command_delay[i]), "s")}  # with that of the background: all there is


@_fault("measurement_delay")
def _measurement_delay(p, i, j, size, rng):
    p.measurement_delay[i] += size
    return {"delay": (size, "s")}


@_fault("actuator_lag")
def _lag(p, i, j, size, rng):
    p.lag[i, j] = size
    return {"time_constant": (size, "s")}


@_fault("torque_saturation")
def _saturation(p, i, j, size, rng):
    p.saturation[i, j] = PEAK_TORQUE[j] * max(1.0 - size, 0.2)
    return {"limit": (p.saturation[i, j], "Nm")}


@_fault("torque_rate_limit")
def _rate_limit(p, i, j, size, rng):
    p.rate_limit[i, j] = PEAK_RATE[j] * max(1.0 - size, 0.15)
    return {"limit": (p.rate_limit[i, j], "Nm/s")}


@_fault("payload")
def _payload(p, i, j, size, rng):
    p.inertials.add_point(i, 6, size, tcp_in_link7())
    return {"mass": (size, "kg")}


@_fault("link_com")
def _com(p, i, j, size, rng):
    angle = rng.uniform(0, 2 * np.pi)
    moment = size * np.array([np.cos(angle), np.sin(angle), 0.0])
    # The mass moves: inertia about the joint follows, inertia about the centre of mass stays.
    p.inertials.com[i, j] += moment / p.inertials.mass[i, j]
    return {f"moment_{axis}": (float(m), "kg m") for axis, m in zip("xyz", moment)}


@_fault("link_inertia")
def _inertia(p, i, j, size, rng):
    p.inertials.inertia[i, j] *= 1.0 + size
    nominal = nominal_inertials(1).inertia[0, j]
    return {"scale": (np.trace(p.inertials.inertia[i, j]) / np.trace(nominal) - 1.0, "1")}


@_fault("armature")
def _armature(p, i, j, size, rng):
    change = _less_or_more(p.armature[i, j], size, rng)
    p.armature[i, j] += change
    return {"inertia": (change, "kg m^2")}


@_fault("gravity_compensation_error")
def _gravity(p, i, j, size, rng):
    p.gravity_scale[i] = draw_sign(rng) * size
    return {"scale": (float(p.gravity_scale[i, 0]), "1")}


@_fault("encoder_bias")
def _bias(p, i, j, size, rng):
    p.encoder_bias[i, j] = draw_sign(rng) * size
    return {"bias": (p.encoder_bias[i, j], "rad")}


@_fault("encoder_quantisation")
def _quantisation(p, i, j, size, rng):
    p.quantum[i, j] = size
    return {"step": (size, "rad")}


@_fault("cable_torque")
def _cable(p, i, j, size, rng):
    centre = NOMINAL.ready[j] + rng.uniform(-0.4, 0.4)
    p.cable_stiffness[i, j], p.cable_centre[i, j] = size, centre
    return {"stiffness": (size, "Nm/rad"), "offset": (size * (NOMINAL.ready[j] - centre), "Nm")}


@_fault("torque_ripple")
def _ripple(p, i, j, size, rng):
    order, phase = float(rng.choice([100, 160, 200])), rng.uniform(0, 2 * np.pi)
    p.ripple[i, j], p.ripple_order[i, j], p.ripple_phase[i, j] = size, order, phase
    return {"sine": (size * np.cos(phase), "Nm"), "cosine": (size * np.sin(phase), "Nm"), "order": (order, "1/rad")}


@_fault("thermal_drift")
def _thermal(p, i, j, size, rng):
    p.thermal_drop[i, j], p.thermal_time[i] = min(size, 0.7), rng.uniform(40.0, 120.0)
    return {"drop": (p.thermal_drop[i, j], "1"), "time_constant": (float(p.thermal_time[i, 0]), "s")}


@_fault("base_tilt")
def _tilt(p, i, j, size, rng):
    angle = rng.uniform(0, 2 * np.pi)
    roll, pitch = size * np.cos(angle), size * np.sin(angle)
    g = -p.inertials.gravity[i, 2]
    # Gravity seen from a base that is rolled about x, then pitched about y: small angles, exact length.
    direction = np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
    p.inertials.gravity[i] = g * direction
    return {"roll": (roll, "rad"), "pitch": (pitch, "rad")}


@_fault("packet_loss")
def _loss(p, i, j, size, rng):
    p.loss[i] = size
    return {"share": (size, "1")}


@_fault("controller_mismatch")
def _filter(p, i, j, size, rng):
    p.filter_time[i] = size
    return {"time_constant": (size, "s")}


EFFECTS = tuple(_FAULTS)


def widen(p: Physics, i: int, fault: Fault, given: Parameters, rng: np.random.Generator) -> Parameters:
    """Make a fault that was given more like an arm's own and less like a column of the diagnosis; what it now is.

    A payload is anywhere on the hand, a link's inertia changes about axes of its own, limits are of all that a drive gives.
    """
    j = fault.joint
    if fault.effect == "payload":
        ((mass, unit),) = given.values()
        p.inertials.add_point(i, 6, -mass, tcp_in_link7())
        p.inertials.add_point(i, 6, mass, tcp_in_link7() + rng.uniform(-1.0, 1.0, 3) * HAND)
        return {"mass": (mass, unit)}
    if fault.effect == "link_inertia":
        before = p.inertials.inertia[i, j] / (1.0 + fault.size * limit_of(fault.effect, j))
        added = np.trace(p.inertials.inertia[i, j] - before)
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        parts = rng.dirichlet(np.full(3, 4.0))
        p.inertials.inertia[i, j] = before + axes @ np.diag(added * 0.5 * (1.0 - parts)) @ axes.T
        return given  # by its trace, as before
    if fault.effect == "torque_saturation":
        p.with_weight[i, j] = 1.0
        p.saturation[i, j] = max(PEAK_TOTAL[j] * (1.0 - fault.size * limit_of(fault.effect, j)), 1.02 * HELD[j])
        return {"limit": (p.saturation[i, j], "Nm")}
    if fault.effect == "torque_rate_limit":
        p.with_weight[i, j] = 1.0
    return given

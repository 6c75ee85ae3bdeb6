"""What an arm may be like beyond its nominal simulator: every number that the plant moves by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from sim2real.effects.joint_dynamics.friction_curve import SPEEDS

from np_blind.arm.plant.rigid_arm import JOINTS, Inertials, nominal_inertials
from np_description.panda import NOMINAL

CURVE_SPEEDS = np.array(SPEEDS)  # rad/s, of a patch's friction curve
NEVER = 1e9  # a limit that is never reached


def _per(shape: tuple[int, ...], value: float = 0.0):
    return field(default=None, metadata={"shape": shape, "value": value})


@dataclass(eq=False)
class Physics:
    """What B arms are like; every array begins with the arm, most go on with the joint. SI units.

    Friction: coulomb_*, viscous_* by direction of motion, nominal included; stribeck_level at standstill
    falls with exp(-(v / stribeck_speed)^2); fall_* Nm at standstill falls with 1 / (1 + (v / fall_speed)^fall_steepness); curve_* Nm at CURVE_SPEEDS, of patches; load_coefficient times the torque through the gear; lugre_*: an
    element beside; breakaway rad: how far a joint yields before it slides. thermal_drop: share of friction
    lost, with time constant thermal_time s; uneven: share of Coulomb friction that comes and goes uneven_order times in a
    turn; holding: share of it that is there on top at standstill. Links: inertials, and those whose weight is compensated,
    the nominal ones or the arm's own. Torques that resist: offset, cable, ripple. Drive: lag s, rate
    Nm/s, saturation Nm, both of all that the drive gives where with_weight is 1, of the command where it is 0; scale;
    drive_noise Nm of each period's torque. Gear where `flexible`: stiffness Nm/rad, damping, play rad (each way),
    hysteresis_* (torque Nm, stroke rad). Sensing: sensor_*, encoder_bias, quantum rad, delays s. Controller:
    stiffness_factor, damping_factor, filter_time s. From rub on: what no catalogue has, see `OutOfCatalogue`;
    from snap on: `WideOutOfCatalogue`.
    """

    inertials: Inertials
    compensated: Inertials
    armature: np.ndarray = _per((JOINTS,))
    coulomb_forward: np.ndarray = _per((JOINTS,))
    coulomb_backward: np.ndarray = _per((JOINTS,))
    viscous_forward: np.ndarray = _per((JOINTS,))
    viscous_backward: np.ndarray = _per((JOINTS,))
    stribeck_level: np.ndarray = _per((JOINTS,))
    stribeck_speed: np.ndarray = _per((JOINTS,), 0.1)
    fall_forward: np.ndarray = _per((JOINTS,))
    fall_backward: np.ndarray = _per((JOINTS,))
    fall_speed: np.ndarray = _per((JOINTS,), 0.1)
    fall_steepness: np.ndarray = _per((JOINTS,), 3.0)
    curve_forward: np.ndarray = _per((JOINTS, len(CURVE_SPEEDS)))
    curve_backward: np.ndarray = _per((JOINTS, len(CURVE_SPEEDS)))
    load_coefficient: np.ndarray = _per((JOINTS,))
    lugre_level: np.ndarray = _per((JOINTS,))
    lugre_stroke: np.ndarray = _per((JOINTS,), 0.01)
    breakaway: np.ndarray = _per((JOINTS,), 1e-4)
    thermal_drop: np.ndarray = _per((JOINTS,))
    thermal_time: np.ndarray = _per((1,), 100.0)
    offset: np.ndarray = _per((JOINTS,))
    cable_stiffness: np.ndarray = _per((JOINTS,))
    cable_centre: np.ndarray = _per((JOINTS,))
    ripple: np.ndarray = _per((JOINTS,))
    ripple_order: np.ndarray = _per((JOINTS,))
    ripple_phase: np.ndarray = _per((JOINTS,))
    lag: np.ndarray = _per((JOINTS,))
    uneven: np.ndarray = _per((JOINTS,))
    uneven_order: np.ndarray = _per((JOINTS,), 1.0)
    uneven_phase: np.ndarray = _per((JOINTS,))
    holding: np.ndarray = _per((JOINTS,))
    drive_noise: np.ndarray = _per(())
    with_weight: np.ndarray = _per((JOINTS,))
    rate_limit: np.ndarray = _per((JOINTS,), NEVER)
    saturation: np.ndarray = _per((JOINTS,), NEVER)
    torque_scale: np.ndarray = _per((JOINTS,))
    gravity_scale: np.ndarray = _per((1,))
    flexible: np.ndarray = _per((JOINTS,))
    stiffness: np.ndarray = _per((JOINTS,), 1e4)
    gear_damping: np.ndarray = _per((JOINTS,), 10.0)
    play: np.ndarray = _per((JOINTS,))
    hysteresis_torque: np.ndarray = _per((JOINTS,))
    hysteresis_stroke: np.ndarray = _per((JOINTS,), 1e-3)
    sensor_scale: np.ndarray = _per((JOINTS,))
    sensor_bias: np.ndarray = _per((JOINTS,))
    encoder_bias: np.ndarray = _per((JOINTS,))
    quantum: np.ndarray = _per((JOINTS,))
    command_delay: np.ndarray = _per(())
    measurement_delay: np.ndarray = _per(())
    loss: np.ndarray = _per(())
    stiffness_factor: np.ndarray = _per((JOINTS,), 1.0)
    damping_factor: np.ndarray = _per((JOINTS,), 1.0)
    filter_time: np.ndarray = _per(())
    noise: np.ndarray = _per((), 1.0)
    rub: np.ndarray = _per((JOINTS,))
    rub_angle: np.ndarray = _per((JOINTS,))
    rub_width: np.ndarray = _per((JOINTS,), 0.05)
    wavy: np.ndarray = _per((JOINTS,))
    wavy_order: np.ndarray = _per((JOINTS,))
    wavy_phase: np.ndarray = _per((JOINTS,))
    cubic: np.ndarray = _per((JOINTS,))
    shake: np.ndarray = _per((JOINTS,))
    shake_frequency: np.ndarray = _per((JOINTS,))
    shake_phase: np.ndarray = _per((JOINTS,))
    ageing: np.ndarray = _per((JOINTS,))
    ageing_time: np.ndarray = _per((JOINTS,), 1.0)
    flutter: np.ndarray = _per((JOINTS,))
    flutter_frequency: np.ndarray = _per((JOINTS,))
    dropout: np.ndarray = _per((JOINTS,))
    coupling: np.ndarray = _per((JOINTS, JOINTS))
    dent: np.ndarray = _per((JOINTS,))
    dent_angle: np.ndarray = _per((JOINTS,))
    dent_width: np.ndarray = _per((JOINTS,), 0.05)
    brake: np.ndarray = _per((JOINTS,))
    part_inertia: np.ndarray = _per((JOINTS,))
    part_frequency: np.ndarray = _per((JOINTS,), 1.0)
    part_damping: np.ndarray = _per((JOINTS,), 0.1)
    taut: np.ndarray = _per((JOINTS,))
    taut_angle: np.ndarray = _per((JOINTS,))
    taut_side: np.ndarray = _per((JOINTS,), 1.0)
    dead_zone: np.ndarray = _per((JOINTS,))
    fading: np.ndarray = _per((JOINTS,))
    fading_time: np.ndarray = _per((JOINTS,), 100.0)
    eccentric: np.ndarray = _per((JOINTS,))
    eccentric_phase: np.ndarray = _per((JOINTS,))
    commutation: np.ndarray = _per((JOINTS,))
    commutation_order: np.ndarray = _per((JOINTS,))
    commutation_phase: np.ndarray = _per((JOINTS,))
    wander: np.ndarray = _per((JOINTS,))
    wander_time: np.ndarray = _per((JOINTS,), 100.0)
    slip: np.ndarray = _per((JOINTS,))
    slip_time: np.ndarray = _per((JOINTS,))
    pack: np.ndarray = _per((JOINTS,))
    pack_stroke: np.ndarray = _per((JOINTS,), 0.1)
    grease: np.ndarray = _per((JOINTS,))
    grease_speed: np.ndarray = _per((JOINTS,), 0.1)
    snap: np.ndarray = _per((JOINTS,))
    snap_angle: np.ndarray = _per((JOINTS,))
    snap_width: np.ndarray = _per((JOINTS,), 0.05)
    lopsided: np.ndarray = _per((JOINTS,))
    notch: np.ndarray = _per((JOINTS,))
    notch_frequency: np.ndarray = _per((JOINTS,), 1.0)
    rotor_coupling: np.ndarray = _per((JOINTS, JOINTS))
    crosstalk: np.ndarray = _per((JOINTS, JOINTS))
    drive_play: np.ndarray = _per((JOINTS,))
    seal: np.ndarray = _per((JOINTS,))
    seal_stroke: np.ndarray = _per((JOINTS,), 0.05)
    sag: np.ndarray = _per((JOINTS,))
    sag_time: np.ndarray = _per((JOINTS,), 0.1)
    creep: np.ndarray = _per((JOINTS,))
    creep_time: np.ndarray = _per((JOINTS,), 0.3)
    converter_step: np.ndarray = _per((JOINTS,))
    tachometer: np.ndarray = _per((JOINTS,))
    cover: np.ndarray = _per((JOINTS,))
    cover_speed: np.ndarray = _per((JOINTS,), 0.3)

    def __post_init__(self):
        arms, joints = self.inertials.mass.shape
        for item in fields(self):
            if item.metadata and getattr(self, item.name) is None:
                shape = (joints if size == JOINTS else size for size in item.metadata["shape"])
                values = np.full((arms, *shape), item.metadata["value"], dtype=float)
                setattr(self, item.name, values)

    def __len__(self) -> int:
        return len(self.inertials.mass)

    def take(self, arms: Sequence[int]) -> Physics:
        """These of the arms."""
        rows = list(arms)
        return Physics(
            self.inertials.take(rows),
            self.compensated.take(rows),
            **{item.name: getattr(self, item.name)[rows] for item in fields(self) if item.metadata},
        )

    def uses(self, name: str) -> bool:
        """Whether an array differs from its default anywhere."""
        default = type(self).__dataclass_fields__[name].metadata["value"]
        return bool((getattr(self, name) != default).any())


def nominal_physics(arms: int) -> Physics:
    """The nominal arm, `arms` times."""
    rows = {
        name: np.tile(values, (arms, 1))
        for name, values in (
            ("armature", NOMINAL.armature),
            ("coulomb_forward", NOMINAL.frictionloss),
            ("coulomb_backward", NOMINAL.frictionloss),
            ("viscous_forward", NOMINAL.damping),
            ("viscous_backward", NOMINAL.damping),
        )
    }
    return Physics(nominal_inertials(arms), nominal_inertials(arms), **rows)


def stack(groups: list[Physics]) -> Physics:
    """The arms of all groups, one group after the other."""
    inertials, compensated = groups[0].inertials, groups[0].compensated
    for group in groups[1:]:
        inertials, compensated = inertials.stacked(group.inertials), compensated.stacked(group.compensated)
    return Physics(
        inertials,
        compensated,
        **{
            item.name: np.concatenate([getattr(group, item.name) for group in groups])
            for item in fields(Physics)
            if item.metadata
        },
    )

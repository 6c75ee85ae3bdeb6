"""Nuisance parameters: what any arm has and no prediction models. Every model may use them besides its effects.

They are random effects with priors of their own, stage by stage of each joint: the delay between command and torque
(r1) and between torque and motion (r2), errors of the links' masses, of where they lie and of their inertia
(`arm.link_errors`), how far a joint yields before it slides the
other way, the zero of the motor's encoder and what even a stiff gear yields (r3). Rows at reversal have those of r2:
without them, errors of the links would be found in the rotors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim2real.arm.nominal_prediction import is_sliding
from sim2real.arm.rigid_body import drive_inertia
from sim2real.effects.evidence import Context
from sim2real.effects.recurrences import bristle_deflection, smooth_sign
from sim2real.effects.regressor import Parameter
from sim2real.effects.stage import Stage
from sim2real.thresholds import THRESHOLDS

NUISANCES = THRESHOLDS.nuisances

TORQUE_CONSTANT = "torque constant"
MOST_ERRORS = 6.0  # standard deviations

_NONE: tuple[Parameter, ...] = ()
_DELAYED = {
    Stage.DRIVE: Parameter("command_delay", "s", -3e-4, 1.4e-3, NUISANCES.delay_spread, centre=NUISANCES.delay),
    Stage.DYNAMICS: Parameter("motion_delay", "s", -3e-4, 1.4e-3, NUISANCES.delay_spread, centre=NUISANCES.delay),
}
# Between two recordings of an arm there is no delay that any loop has.
_DRIFTED = {
    stage: replace(p, lower=-3e-4, upper=3e-4, prior=NUISANCES.delay_between, centre=0.0)
    for stage, p in _DELAYED.items()
}
# Shares of the nominal friction that turn over late, within each of `NUISANCES.breakaways`: they span what lies between.
# The larger is also that of a joint with more friction on the same bristles.
_TURNING = (
    Parameter("breakaway", "1", 0.0, 10.0, NUISANCES.breakaway_spread, centre=1.0),
    Parameter("late breakaway", "1", -2.0, 10.0, NUISANCES.late_breakaway_spread),
    Parameter("creep", "1", -2.0, 10.0, NUISANCES.late_breakaway_spread),
)
# An arm creeps on one day as on another.
_TURNED = tuple(replace(p, lower=-p.upper, centre=0.0) for p in _TURNING)
# Shares of the nominal friction by which it goes up and down with the joint's angle.
_UNEVEN = tuple(
    Parameter(f"{wave} of friction, order {order}", "1", -0.5, 0.5, NUISANCES.uneven)
    for order in NUISANCES.uneven_orders
    for wave in ("sine", "cosine")
)
# Shares of the nominal friction and damping by which a joint has more or less of it; beyond two deviations it is a fault,
# and what it is must be left to be explained.
_LEVELS = (
    Parameter("level of friction", "1", -2 * NUISANCES.friction, 2 * NUISANCES.friction, NUISANCES.friction),
    Parameter("level of damping", "1", -2 * NUISANCES.damping, 2 * NUISANCES.damping, NUISANCES.damping),
)
# Without commands, measured torque and motion may come from clocks of their own.
_LOOSE = Parameter("motion_delay", "s", -0.01, 0.01, NUISANCES.loose_delay_spread)


def nuisance_parameters(context: Context, stage: Stage, joint: int) -> tuple[Parameter, ...]:
    """The nuisance parameters of one stage of one joint, in the order of `nuisance_columns`."""
    if stage is Stage.DRIVE:
        return (_DRIFTED[stage] if context.reference else _DELAYED[stage],)
    if stage is Stage.DYNAMICS:
        usual = _DRIFTED[stage] if context.reference else _DELAYED[stage]
        late = usual if context.drive is not None else _LOOSE
        whole = Parameter("inertia felt", "kg m^2", -1.0, 1.0, _attenuation(context, joint))
        turning = _TURNED if context.reference else _TURNING
        components = _links(context, joint).shape[1]
        links = (Parameter(f"links {n + 1}", "1", -MOST_ERRORS, MOST_ERRORS, 1.0) for n in range(components))
        return (late, whole, *turning, *_UNEVEN, *_LEVELS, *_constant(context), *links)
    if stage is Stage.TRANSMISSION:
        return (
            Parameter("zero", "rad", -0.1, 0.1, NUISANCES.zero_spread),
            Parameter("yield", "rad/Nm", -2 * NUISANCES.gear_yield, 2 * NUISANCES.gear_yield, NUISANCES.gear_yield),
        )
    return _NONE


def nuisance_columns(context: Context, stage: Stage, joint: int) -> np.ndarray:
    """Columns (n, count) of the `nuisance_parameters` of one stage of one joint."""
    c = context
    if stage is Stage.DYNAMICS:
        # After a reversal friction is late, and resists the acceleration less: it looks like less inertia.
        late = (
            c.arm.frictionloss[joint]
            * c.samples.filter_function(joint, lambda q, v, x=reach: bristle_deflection(q, x) - smooth_sign(v))
            for reach in NUISANCES.breakaways
        )
        motion = c.samples.torque_rate[:, joint], c.samples.acceleration[:, joint]
        sliding = c.prediction.direction[:, joint], c.samples.velocity[:, joint]
        levels = (own * column for own, column in zip((c.arm.frictionloss[joint], c.arm.damping[joint]), sliding))
        constant = [] if c.constant is None else [c.constant[:, joint]]
        return np.column_stack([*motion, *late, _uneven(c, joint), *levels, *constant, _links(c, joint)])
    if stage is Stage.TRANSMISSION:
        return np.column_stack([np.ones(len(c.transmission.time)), c.transmission.load[:, joint]])
    if stage is Stage.DRIVE:
        # Commands are held for a period: to be late by less than that is a share of the one before.
        step = np.diff(c.drive.commanded[:, joint], prepend=c.drive.commanded[0, joint])
        step[c.drive.starts] = 0.0
        return -step[:, None] / c.drive.period
    return np.zeros((len(c.drive.time), 0))


def _links(context: Context, joint: int) -> np.ndarray:
    """Torques (n, c) Nm of what the links are off by; none between two recordings of an arm, which has the same links.

    A joint turns what is beyond it: each link may be off by itself. (One factor for all of them would leave a part to
    torque_scale, which looks like it in a joint that no gravity loads.)
    """
    return context.prediction.link_errors[joint][:, : 0 if context.reference else None]


def _constant(context: Context) -> tuple[Parameter, ...]:
    """Of a motor's current: the share by which its torque constant is larger than it should be."""
    if context.constant is None:
        return ()
    return (Parameter(TORQUE_CONSTANT, "1", -0.9, 2.0, THRESHOLDS.current.spread),)


def _uneven(context: Context, joint: int) -> np.ndarray:
    """Nominal friction (n, waves) Nm times waves of the joint's angle.

    On average there is none of them: how much friction a joint has is another nuisance.
    """
    direction = context.prediction.direction[:, joint]
    angle = context.samples.position[:, joint] - context.arm.rest[joint]
    waves = [f(order * angle) for order in NUISANCES.uneven_orders for f in (np.sin, np.cos)]
    columns = np.column_stack([direction * wave for wave in waves])
    columns -= np.outer(direction, direction @ columns / max(direction @ direction, 1e-12))
    return context.arm.frictionloss[joint] * columns


def _attenuation(context: Context, joint: int) -> float:
    """Inertia kg m^2 of a drive that the noise in a measured acceleration hides: the best prediction from a noisy
    regressor is by the share of noise in it too small (Fuller, Measurement Error Models, 1987)."""
    felt = drive_inertia(context.arm, np.median(context.samples.position, axis=0))[joint]
    moved = context.samples.acceleration[is_sliding(context.samples, joint), joint]
    noise = context.samples.shaking[joint] ** 2 / (np.mean(moved**2) if moved.size else 1.0)
    return float(felt * (NUISANCES.acceleration_error + min(noise, NUISANCES.noise_share)))

"""Measurement delay: states are older than their stamps."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from sim2real.effects import evidence
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DelayLine, HookContext, SensorHook, SensorSlot
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

DELAY = Quantity("delay", "s", -0.05, 0.05)
LEAST = 3e-4  # s beyond what the loop has, up to which states may be older than their stamps
KNOWN = 1e-4  # s, to which filtered motion determines one


def _torque_rate(c: Context, j: int) -> np.ndarray:
    """Rate (n, 1) Nm/s of all that the motion takes: gravity is compensated where the arm was, too."""
    rate = c.samples.torque_rate[:, j]
    if not c.samples.with_gravity:
        rate = rate + (c.prediction.gravity_slope[:, j] * c.samples.velocity).sum(axis=1)
    return stack(rate)


def _differentiate(d: evidence.Drive, values: np.ndarray) -> np.ndarray:
    """Rate (n,) 1/s within each stretch; 0 in one of a single row, between two states that got no command."""
    parts = np.split(values, d.starts[1:])
    return np.concatenate([np.gradient(part, d.period) if len(part) > 1 else np.zeros(len(part)) for part in parts])


def _regressors(context: Context) -> list[EffectRegressor]:
    delay = (Parameter("delay", "s", DELAY.lower, DELAY.upper, 0.004, background=KNOWN, least=LEAST),)
    found = [
        EffectRegressor(
            "measurement_delay",
            delay,
            {Stage.DYNAMICS: _torque_rate},
            "states are older than their stamps",
            is_arm=True,
            absorbs="motion_delay",
        )
    ]
    if context.drive is not None:
        found.append(
            EffectRegressor(
                "measurement_delay",
                delay,
                {Stage.CONTROLLER: lambda c, j: stack(-_differentiate(c.drive, c.drive.law[:, j]))},
                "the controller acts on older states than it reports",
                "in the controller",
                is_arm=True,
            )
        )
    return found


def _delay_states(values: HookContext):
    delay = DelayLine(values("delay").clip(0.0) / values.period)

    def sense(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle, speed = delay(namespace(q).stack([q, dq]))
        return angle, speed, torque

    return sense


EFFECT = Effect(
    "measurement_delay",
    EffectTarget.ARM,
    (DELAY,),
    _regressors,
    DetectionLimit("s", 5e-4),
    sensors=SensorHook(SensorSlot.AGE, _delay_states),
    sentence_template="measured states are {delay:ms older/younger} than their stamps",
)

"""sensing: encoders and torque sensors that are off. Encoders show in r2 of every joint that bears weight,
torque sensors in r1 only: with commands, r2 is taken from the commanded torque, and the motion knows nothing of
the sensor."""

from __future__ import annotations

import numpy as np

from np_diagnosis.effects.base import Context, Effect, Parameter, stack


def effects(context: Context) -> list[Effect]:
    """An encoder's bias is an effect of the arm that sits at a joint; sensors are of one joint."""
    found = [
        Effect(
            "encoder_bias",
            (Parameter("bias", "rad", -0.04, 0.04, 0.005),),
            {"r2": lambda c, j, k=k: -c.prediction.gravity_slope[:, j, k : k + 1]},
            "gravity torque at q - b, to first order",
            f"joint {k + 1}",
            is_arm=True,
            component=context.arm.joints[k],
        )
        for k in range(len(context.arm))
    ]
    if context.drive is not None:
        gain, offset = Parameter("gain", "1", -0.5, 0.5, 0.03), Parameter("offset", "Nm", -5.0, 5.0, 0.3)
        found.append(
            Effect(
                "torque_sensor_error",
                (offset,),
                {
                    "r1": lambda c, j: np.ones((len(c.drive.time), 1)),
                },
                "y = tau + offset",
                "offset only",
            )
        )
        found.append(
            Effect(
                "torque_sensor_error",
                (gain, offset),
                {
                    "r1": lambda c, j: stack(
                        c.drive.commanded[:, j] + c.drive.gravity[:, j], np.ones(len(c.drive.time))
                    ),
                },
                "y = (1 + gain) tau + offset",
            )
        )
    return found


def quantised(step: float) -> Effect:
    """The finding that an encoder reads in steps (rad): seen in the readings themselves, not in torque."""
    return Effect("encoder_quantisation", (Parameter("step", "rad", 0.0, 0.01, 1e-3),), {}, "readings lie on a grid")


def find_quantum(position: np.ndarray) -> float:
    """Step rad of an encoder from its readings (n,): 0 where they lie on no grid."""
    steps = np.abs(np.diff(position))
    steps = steps[steps > 1e-12]
    if len(steps) < 100:
        return 0.0
    quantum = float(np.percentile(steps, 1))
    if quantum < 1e-7:
        return 0.0
    smallest = steps[steps < 1.5 * quantum]
    quantum = float(smallest.mean())
    off = np.abs(steps / quantum - np.round(steps / quantum))
    small = steps < 20 * quantum
    return quantum if small.sum() > 100 and np.mean(off[small] < 0.05) > 0.95 else 0.0

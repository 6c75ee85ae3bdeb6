"""A reference arm whose joint parameters are known: what identification is tested on without a robot.

It stands where the robot stands: the deployed controller follows the excitation suite and responds to noisy
states at 500 Hz. Its physics steps four times a control period, so that its discretisation is not that of the
replay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from sim2real.excitation.suite import Segment

from np_blind.baselines.closed_loop import FIELDS, Stretch, stretch
from np_blind.baselines.plant import panda_plant
from np_control.controller import Controller, ControllerConfig

PERIOD_NS = 2_000_000
SUBSTEPS = 4
POSITION_NOISE = 1e-5  # rad, standard deviation
VELOCITY_NOISE = 1e-3  # rad/s
FACTORS = {
    "frictionloss": (0.5, 3.0),
    "damping": (0.5, 6.0),
    "armature": (0.6, 1.8),
}  # of the nominal parameters


def known_arm(seed: int) -> dict[str, np.ndarray]:
    """Parameters (7,) of a reference arm: nominal ones times uniform factors, as `replay.Values`."""
    rng, nominal = np.random.default_rng(seed), panda_plant().nominal()
    return {name: nominal[name] * rng.uniform(*bounds, 7) for name, bounds in FACTORS.items()}


def record(parameters: Mapping[str, np.ndarray], plan: Sequence[Segment], seed: int = 0) -> list[Stretch]:
    """What a recorder would have kept of an arm with these parameters on this plan, one stretch a segment.

    The arm begins every segment at rest at its first knot. Raises FloatingPointError where the arm diverges.
    """
    plant = panda_plant(timestep=PERIOD_NS * 1e-9 / SUBSTEPS)
    for name, field in FIELDS.items():
        getattr(plant.model, field)[:] = parameters[name]
    data = mujoco.MjData(plant.model)
    mujoco.mj_setConst(plant.model, data)
    rng = np.random.default_rng(seed)
    recorded = []
    for segment in plan:
        stiffness, ratio = segment.gains
        controller = Controller(ControllerConfig(stiffness=stiffness, damping_ratio=float(ratio[0])))
        mujoco.mj_resetData(plant.model, data)
        data.qpos[:] = segment.positions[0]
        rows = []
        for i in range(round(segment.duration * 1e9 / PERIOD_NS)):
            position = data.qpos + rng.normal(0.0, POSITION_NOISE, 7)
            velocity = data.qvel + rng.normal(0.0, VELOCITY_NOISE, 7)
            controller.observe(i * PERIOD_NS, position, velocity)
            if i == 0:
                controller.follow(segment.trajectory)
            answer = controller.answer()
            rows.append((position, velocity, answer.position, answer.torque))
            data.qfrc_applied[:] = answer.torque
            mujoco.mj_step(plant.model, data, SUBSTEPS)
        if not np.isfinite(data.qpos).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise FloatingPointError(f"reference arm diverged in segment {segment.name}")
        recorded.append(stretch(segment.name, PERIOD_NS * 1e-9, *map(np.array, zip(*rows)), stiffness, ratio))
    return recorded

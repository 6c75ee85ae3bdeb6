"""r4: the closed loop in the simulator, from recorded targets and gains, against the recorded motion.

The torque domain says what the arm lacks; this says what that means for where it goes. The simulator is started
from recorded states again and again (multiple shooting), each time for a second, under the impedance law with
the recorded targets: nominal, and with the patch. What was fed forward is taken from the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from np_description.domains import CARD
from np_description.panda import JOINT_NAMES
from np_description.patch import Patch
from np_description.scene import load_model
from np_sim_bridge.gap import Gap

from np_diagnosis.signals import Log

WINDOW = 1.0  # s that each shot goes on
EVERY = 3.0  # s from one shot to the next
SETTLED = 0.1  # s of a shot that do not count: rest of the start


@dataclass(frozen=True, eq=False)
class Shots:
    """RMS (k,) rad of the joint angles' departure from the recording within the window; windows used."""

    rms: np.ndarray
    count: int


def shoot(log: Log, patch: Patch = Patch(), every: float = EVERY) -> Shots | None:
    """Closed-loop departure of the Panda's simulator with a patch; None for a log without commands.

    Raises FloatingPointError where the simulation diverges.
    """
    c = log.commands
    if c is None:
        return None
    period = float(np.median(np.diff(log.time)))
    model = load_model(CARD, timestep=period, panda=patch.panda())
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    joints = np.array([model.joint(name).dofadr[0] for name in JOINT_NAMES])
    angles = np.array([model.joint(name).qposadr[0] for name in JOINT_NAMES])
    motors = np.array([model.actuator(name).id for name in JOINT_NAMES])
    steps, settled = round(WINDOW / period), round(SETTLED / period)
    lead = c.target + c.damping / c.stiffness * c.target_velocity
    fed = c.torque - c.stiffness * (lead - log.position[c.rows]) + c.damping * log.velocity[c.rows]
    squares, count = np.zeros(len(JOINT_NAMES)), 0
    for start in range(0, len(c.rows) - steps, max(1, round(every / period))):
        if c.rows[start + steps] - c.rows[start] != steps:
            continue
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[angles], data.qvel[joints] = log.position[c.rows[start]], log.velocity[c.rows[start]]
        gap = Gap(patch, period) if patch.effects else None
        for k in range(start, start + steps):
            q, dq = data.qpos[angles], data.qvel[joints]
            if gap is not None:
                q_seen, dq_seen, _ = gap.sense(q, dq, np.zeros_like(q))
            else:
                q_seen, dq_seen = q, dq
            torque = c.stiffness[k] * (lead[k] - q_seen) - c.damping[k] * dq_seen + fed[k]
            if gap is not None:
                torque = gap.drive(torque)
                data.qfrc_applied[joints] = gap.extra(q, dq)
            data.ctrl[motors] = torque
            mujoco.mj_step(model, data)
            if k - start >= settled:
                seen = data.qpos[angles] if gap is None else data.qpos[angles] + gap.bias
                squares += np.square(seen - log.position[c.rows[k + 1]])
        if not np.isfinite(data.qpos).all():
            raise FloatingPointError(f"{log.name}: the simulation from {log.time[c.rows[start]]:.2f} s diverged")
        count += 1
    if not count:
        return None
    return Shots(np.sqrt(squares / (count * (steps - settled))), count)

"""What every structure may use besides its effects: what any arm has, and no prediction can know.

Random effects with a prior of their own, stage by stage of each joint: the delay between command and torque
(r1) and between torque and motion (r2), an error of each link's inertia, the zero of the motor's encoder and
what even a stiff gear yields (r3).
"""

from __future__ import annotations

import numpy as np

from np_diagnosis.effects import Context, Parameter

REVERSAL = "r2 at reversal"

DELAY = 2e-4  # s between command and torque that a loop has before its recording is asked (loop_delay.py)
ACCELERATION_ERROR = 0.005  # noise in a measured acceleration makes what it multiplies look smaller
GEAR_YIELD = 1e-5  # rad/Nm: no gear is stiffer than some 1e5 Nm/rad, and a rigid one is no worse a model of that
INERTIA_ERROR = 0.03  # standard deviation of a link's inertia about its centre of mass: CAD without cables and glue

_NONE: tuple[Parameter, ...] = ()
_DELAYED = {
    "r1": Parameter("command_delay", "s", -3e-4, 8e-4, 1.5e-4, centre=DELAY),
    "r2": Parameter("motion_delay", "s", -3e-4, 8e-4, 1.5e-4, centre=DELAY),
}
# Without commands, measured torque and motion may come from clocks of their own.
_LOOSE = Parameter("motion_delay", "s", -0.01, 0.01, 1e-3)


def parameters(context: Context, stage: str, joint: int) -> tuple[Parameter, ...]:
    """Of one stage of one joint, in the order of `columns`."""
    if stage == "r1":
        return (_DELAYED["r1"],)
    if stage == "r2":
        late = _DELAYED["r2"] if context.drive is not None else _LOOSE
        whole = Parameter("inertial torque", "1", -0.05, 0.05, ACCELERATION_ERROR)
        links = (Parameter(f"inertia of link {i + 1}", "1", -0.5, 0.5, INERTIA_ERROR) for i in _carried(context, joint))
        return (late, whole, *links)
    if stage == "r3":
        return (Parameter("zero", "rad", -0.1, 0.1, 0.01), Parameter("yield", "rad/Nm", -1e-4, 1e-4, GEAR_YIELD))
    return _NONE


def columns(context: Context, stage: str, joint: int) -> np.ndarray:
    """Columns (n, count) of the `parameters`."""
    c = context
    if stage == "r2":
        whole = c.prediction.inertial[:, joint] + c.prediction.rotors[:, joint]
        # A joint turns what is beyond it: each link's inertia may be off by itself. (One factor for all of them
        # would leave a part to torque_scale, which looks like it in a joint that no gravity loads.)
        links = c.prediction.inertia[:, joint, _carried(c, joint)]
        return np.column_stack([c.samples.torque_rate[:, joint], whole, links])
    if stage == "r3":
        return np.column_stack([np.ones(len(c.transmission.time)), c.transmission.load[:, joint]])
    if stage == "r1":
        # Commands are held for a period: to be late by less than that is a share of the one before.
        step = np.diff(c.drive.commanded[:, joint], prepend=c.drive.commanded[0, joint])
        step[c.drive.starts] = 0.0
        return -step[:, None] / c.drive.period
    return np.zeros((len(c.samples) if stage == REVERSAL else len(c.drive.time), 0))


def _carried(context: Context, joint: int) -> list[int]:
    """Links that a joint turns."""
    arm, found = context.arm, []
    for link in range(len(arm)):
        i = link
        while i > joint:
            i = int(arm.parent[i])
        if i == joint:
            found.append(link)
    return found

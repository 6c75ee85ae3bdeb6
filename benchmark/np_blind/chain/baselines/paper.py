"""A baseline of the chain's set: the paper's identification, of the arm alone.

Friction, damping and armature of each joint by CMA-ES, as Kim et al. (IROS 2023) do before their randomisation: commands are replayed until the
joint positions agree (`np_blind.baselines.identification`). The task suite has no sinusoids of single joints; what of it the hand does in the
air is used, and of each joint the windows in which it moves most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from sim2real.effects.patch import Patch
from sim2real.simulation.closed_loop import Stretch, stretches
from sim2real.simulation.simulated_arm import panda_plant
from sim2real.task.object_motion.stage import errors
from sim2real.task.suite.recording import TaskRecording

from np_blind.arm.drawn.faults import limit_of
from np_blind.baselines.budget import Budget
from np_blind.baselines.identification import paper_identification
from np_blind.baselines.methods import as_patch
from np_blind.chain.others import Told
from np_control.safety import LIMITS
from np_description.panda import JOINT_NAMES, NOMINAL

IN_THE_AIR = ("transfer", "drag_0")
"""Segments of the task suite in which the hand touches nothing; the first drag is the way of the others above the object."""
BUDGET = Budget(window=1.0, windows=3, generations=30, population=8, threads=1)


def ask(recording: TaskRecording, seed: int) -> Told:
    """What the identification makes of a recording, which must have its commands."""
    plant = panda_plant(timestep=LIMITS.period)
    fit = paper_identification(plant, list(in_the_air(recording)), BUDGET, seed)
    arm = replace(NOMINAL, **fit.values)
    changes = [
        (e.effect, JOINT_NAMES.index(e.component), value)
        for e in as_patch(plant, fit).effects
        for value in e.parameters.values()
    ]
    named = sorted({effect for effect, joint, value in changes if abs(value) >= limit_of(effect, joint)})
    found = {f"{effect} {JOINT_NAMES[joint]}": value for effect, joint, value in changes}

    def off(fresh: Sequence[TaskRecording]) -> np.ndarray:
        return errors(fresh, Patch(), panda=arm)

    return Told(named, found, off)


def in_the_air(recording: TaskRecording) -> Iterator[Stretch]:
    """Stretches of a recording of at least a window in which the hand touches nothing."""
    (whole,) = stretches(recording.log)
    begins = [(at, state.experiment) for at, state in recording.log.phases]
    ends = [*(at for at, _ in begins[1:]), float(recording.log.time[-1])]
    for (begin, name), end in zip(begins, ends):
        if name in IN_THE_AIR and end - begin > BUDGET.window:
            yield whole.cut(slice(*np.searchsorted(recording.log.time, [begin, end]).tolist()))

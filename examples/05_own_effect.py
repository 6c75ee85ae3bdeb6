"""An effect of your own (examples/effects/steady_pull.py) in a simulated arm: what a constant pull at the hand does to the joints."""

import os
from pathlib import Path

os.environ["NP_EFFECTS_PATH"] = str(Path(__file__).parent / "effects")  # before the registry is imported

import numpy as np
from sim2real.effects import EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.patch import Patch, PatchEffect

from np_description.panda import NOMINAL

effect = EFFECTS["steady_pull"]
print("parameters:", ", ".join(f"{q.name} {q.lower:g} to {q.upper:g} {q.unit}" for q in effect.quantities))

pull = Patch((PatchEffect("steady_pull", "arm", {"force_z": -5.0}),))
arm_effects = ArmEffects([pull], 0.002)  # one simulated arm, steps of 2 ms
torque = arm_effects.extra(NOMINAL.ready[None], np.zeros((1, 7)))[0]
print("torque on the joints at rest, Nm:", torque.round(2))

"""What reality may have that its nominal simulator has not: one file an effect, with everything that it is.

An `effect.Effect` defines what a patch may give for it, how the simulated arm, camera or scene changes by it, and how it shows
in a recording. Simulators, training, the diagnosis and the blind test all take it from here.
"""

from sim2real.effects.registry import ARM_EFFECTS, CAMERA_EFFECTS, EFFECTS, SCENE_EFFECTS

__all__ = ["ARM_EFFECTS", "CAMERA_EFFECTS", "EFFECTS", "SCENE_EFFECTS"]

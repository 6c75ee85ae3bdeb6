"""What an arm may have that its nominal simulator has not: one file an effect, with everything that it is.

A record (`record.EffectRecord`) says what a patch may give for the effect, how the arm changes by it in a simulator, and how
it shows in a recording. The bridge, training, the doctor and the blind test all take it from here.
"""

from sim2real.effects.registry import RECORDS, SCENE_RECORDS, VIEW_RECORDS

__all__ = ["RECORDS", "SCENE_RECORDS", "VIEW_RECORDS"]

"""The patch: what the diagnosis found, as changes of the nominal arm; tried in simulation before that, on held-out motion.

The equations of motion decide what is there. Whether the simulator gets closer with it is another question, tested on
the closed loop (`multiple_shooting`): an effect that makes it depart further from what was recorded is left out, and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.inference.bootstrap import draw_counts
from sim2real.thresholds import THRESHOLDS

if TYPE_CHECKING:
    from sim2real.simulation.multiple_shooting import ShootingWindows

PATCHING = THRESHOLDS.patching


@dataclass(frozen=True, eq=False)
class SimulatedEffect:
    """One effect of a patch in simulation, beside the others that were in the patch when it was tried."""

    effect: str
    """Its id."""
    component: str
    """Where it sits."""
    without: float
    """RMS departure rad of the patch without it."""
    with_it: float
    """RMS departure rad of the patch with it."""
    interval: tuple[float, float]
    """95 % interval of the reduction 1 - with_it / without, over windows."""

    @property
    def title(self) -> str:
        """Effect and place."""
        return f"{self.effect} at {self.component}"


@dataclass(frozen=True, eq=False)
class PatchTrial:
    """The simulator's departure from recorded motion within short windows, without and with the patch."""

    is_held_out: bool
    """Whether neither fit nor choice of effects has seen the motion."""
    windows: int
    """Number of windows."""
    before: np.ndarray
    """(7,) RMS departure rad of the nominal arm."""
    after: np.ndarray
    """(7,) RMS departure rad with the patch; infinite where the simulation diverges."""
    interval: tuple[float, float]
    """95 % interval of the reduction of all joints together, over windows."""
    effects: tuple[SimulatedEffect, ...]
    """Each effect of the patch, and each that was left out."""
    left_out: tuple[str, ...] = ()
    """Effects that are not in the patch for the harm that they do."""


def make_patch(diagnosis: Diagnosis) -> Patch:
    """The chosen effects, for the simulated arm and for training; of a joint with more left, those that are shown to help."""
    joints = diagnosis.context.arm.joints
    unexplained = {joints[j] for j in diagnosis.unexplained}
    chosen = [f for f in diagnosis.findings if f.is_chosen and (f.component not in unexplained or f.is_shown_to_help)]
    return Patch(
        tuple(
            PatchEffect(
                f.effect.id,
                f.component,
                {**{name: e.value for name, e in f.parameters.items()}, **f.effect.constants},
            )
            for f in chosen
        )
    )


def try_patch(diagnosis: Diagnosis) -> tuple[Patch, PatchTrial | None]:
    """(the patch without what does harm, its trial in simulation): on the windows laid aside, or on all where there are none.

    None, and the patch as it is, for another arm, or recordings without commands.
    """
    # The simulator takes a second to import, which a quick look has not.
    from sim2real.simulation.multiple_shooting import cut_windows

    patch, context, effects, left_out = make_patch(diagnosis), diagnosis.context, {}, []
    recorded = cut_windows(context.logs, spans=context.laid_aside) if context.arm.joints == NOMINAL.joints else None
    if recorded is None:
        return patch, None
    drawn = draw_counts(len(recorded), THRESHOLDS.held_out.bootstraps, 0)
    while True:
        fewer = [Patch(tuple(e for e in patch.effects if e is not one)) for one in patch.effects]
        nominal, whole, *without = _squares(recorded, [Patch(), patch, *fewer])
        for one, squares in zip(patch.effects, without):
            tried = _simulated(one, squares, whole, drawn)
            effects[tried.title] = tried
        harm = [whole.sum() - squares.sum() for squares in without]
        is_worse = whole.sum() > PATCHING.worse**2 * nominal.sum()
        sure = [n for n, e in enumerate(patch.effects) if effects[f"{e.effect} at {e.component}"].interval[1] < 0]
        suspects = sure or (range(len(harm)) if is_worse else ())
        if not suspects:
            break
        worst = max(suspects, key=lambda n: harm[n])
        left_out.append(f"{patch.effects[worst].effect} at {patch.effects[worst].component}")
        patch = fewer[worst]
    before, after = np.sqrt(nominal.mean(axis=0)), np.sqrt(whole.mean(axis=0))
    interval = _interval(nominal, whole, drawn)
    is_held_out = bool(context.laid_aside)
    return patch, PatchTrial(
        is_held_out, len(recorded), before, after, interval, tuple(effects.values()), tuple(left_out)
    )


def _simulated(one: PatchEffect, without: np.ndarray, with_it: np.ndarray, drawn: np.ndarray) -> SimulatedEffect:
    old, new = (float(np.sqrt(squares.mean())) for squares in (without, with_it))
    return SimulatedEffect(one.effect, one.component, old, new, _interval(without, with_it, drawn))


def _interval(before: np.ndarray, after: np.ndarray, drawn: np.ndarray) -> tuple[float, float]:
    """95 % interval of the reduction of the RMS; before, after: squares (W, 7) rad^2; drawn (draws, W)."""
    old, new = (drawn @ squares.sum(axis=1) for squares in (before, after))
    if not np.isfinite([old.sum(), new.sum()]).all():
        return -np.inf, -np.inf
    low, high = np.quantile(1 - np.sqrt(new / np.maximum(old, 1e-24)), (0.025, 0.975))
    return float(low), float(high)


def _squares(recorded: ShootingWindows, patches: Sequence[Patch]) -> np.ndarray:
    """Mean squares (P, W, 7) rad^2 of each patch; infinite where the simulation diverges or has no such arm."""
    from sim2real.simulation.multiple_shooting import simulate_departures

    try:
        return np.square(simulate_departures(recorded, patches)).mean(axis=2)
    except (FloatingPointError, ValueError):
        if len(patches) == 1:
            return np.full((1, len(recorded), len(NOMINAL.joints)), np.inf)
        return np.concatenate([_squares(recorded, [patch]) for patch in patches])

"""Command delay: dead time between command and torque, the same in all joints, for their commands travel in one packet."""

from __future__ import annotations

import numpy as np

from sim2real.effects import evidence
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DelayLine, DriveFunction, DriveHook, DriveSlot, HookContext
from sim2real.effects.regressor import WHOLE, EffectRegressor, NonlinearParameter, stack
from sim2real.effects.stage import Stage

DELAY = Quantity("delay", "s", 0.0, 0.2)
USUAL = 1e-3  # s, up to which a delay of commands is what any loop has: a cycle of 1 kHz
DELAYS = tuple(1e-4 * 1.35**n for n in range(18))  # s beyond it: so fine that the best leaves nothing to other effects
STEP_KNOWN = 2e-5  # s, to which a delay is known where commands are held for a period


def delay_commands(d: evidence.Drive, values: np.ndarray, delay: float) -> np.ndarray:
    """values (n,) as they were `delay` s before; the first of each stretch before that."""
    periods, share = divmod(delay / d.period, 1.0)
    ends, late = [*d.starts[1:], len(values)], np.empty_like(values)
    for start, end in zip(d.starts, ends):
        part = values[start:end]
        padded = np.concatenate([np.full(int(periods) + 1, part[0]), part])[: len(part) + 1]
        late[start:end] = (1 - share) * padded[1:] + share * padded[:-1]
    return late


def _regressor(delay: float) -> EffectRegressor:
    """What a loop is late by beyond the usual, which is a nuisance's: of the two together nothing counts twice. Of a change, what
    it is late by beyond what it was."""

    def columns(c: Context, j: int) -> np.ndarray:
        d, values = c.drive, c.drive.commanded[:, j]
        usual = d.late if c.reference else USUAL
        return stack(delay_commands(d, values, usual + delay) - delay_commands(d, values, usual))

    return EffectRegressor(
        "command_delay",
        (WHOLE,),
        {Stage.DRIVE: columns},
        "dead time between command and torque",
        f"{1e3 * delay:.3g} ms",
        # Not linear: what noise puts into the commands changes from period to period, and only the right delay meets it.
        NonlinearParameter("delay", "s", delay, _regressor, background=STEP_KNOWN),
        is_arm=True,
        absorbs="command_delay",
    )


def _regressors(context: Context) -> list[EffectRegressor]:
    return [] if context.drive is None else [_regressor(delay) for delay in DELAYS]


def _delay(values: HookContext) -> DriveFunction:
    return DelayLine(values("delay").clip(0.0) / values.period)


EFFECT = Effect(
    "command_delay",
    EffectTarget.ARM,
    (DELAY,),
    _regressors,
    DetectionLimit("s", 5e-4),
    drive=DriveHook(DriveSlot.TRANSPORT, _delay),
    sentence_template="commands take effect {delay:ms later/earlier} than in {nominal}",
)

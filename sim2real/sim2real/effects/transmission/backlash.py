"""Backlash: the motor leads by half the play, whichever side drives. No simulated arm has the motor's side.

In a joint that its load presses to one side the load's sign is the side. In one that nothing loads the gear floats in its
play: there the side is what the twist itself shows, once it is beyond a share of its own reach.
"""

from __future__ import annotations

import numpy as np

from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage

HALF_PLAY = Quantity("half_play", "rad", 0.0, 0.05)
PLAY_TORQUE = 4e-4  # of the torque limit, at which the side of the play is sure
PLAY_KNOWN = 1e-5  # rad
EDGE = 0.05  # of the time that a twist is further out than its reach
LEAST_REACH = 4e-5  # rad, below which a twist is noise of two encoders, or what any gear yields
SURE_AT = (0.25, 0.5, 0.75)  # of the reach; never at all of it, or any twist would be explained by itself
SURE_LOAD = 3e-3  # of the torque limit, from which on a load pushes a gear to one side of its play
SURE_ROWS = 50  # fewest rows in which that is looked at
ALIKE = 0.7  # mean of +1 where twist and load agree and -1 where not: .95 of a play of .7 mrad, .44 of a disc off its centre
# Between two sides a gear is where it is: how fast it crosses is known to a share only. From 4 cases of development seed 9700.
FLOATING_MODEL = 0.05


def _load_side(c: Context, j: int) -> np.ndarray:
    """Which side of the play the load (n,) is carried by, -1..1."""
    return np.tanh(c.transmission.load[:, j] / (PLAY_TORQUE * c.arm.torque_limit[j]))


def _twist_side(c: Context, j: int, share: float) -> np.ndarray:
    """Side (n,) of the play at which the twist shows the gear, -1..1: all the way at a share of the twist's reach.

    A reference has a reach of its own, and where that is none its load determines the side, as of any play that it might have had. By the
    later recordings' reach its column would be nought, and what both "have in common" would be the change itself.
    """
    t, later = c.transmission, _twist_range(c, j)
    spans = [
        later if c.is_later(number) else _quantile_range([w[:, j]]) for w, (number, _) in zip(t.wound, c.samples.grids)
    ]
    sides = [np.clip((w[:, j] - m) / (share * max(r, LEAST_REACH)), -1.0, 1.0) for w, (m, r) in zip(t.wound, spans)]
    still = {number for (number, _), (_, reach) in zip(c.samples.grids, spans) if reach <= LEAST_REACH}
    return np.where(np.isin(t.trajectory, list(still)), _load_side(c, j), c.samples.filter(sides))


def _follows_load(c: Context, j: int) -> bool:
    """Whether a joint's twist is where its load pushes it, wherever it is loaded for sure: so is a gear in its play, and not
    a twist that follows the angle (an encoder's disc off its centre) or nothing (steps of an encoder)."""
    load = c.transmission.load[:, j]
    sure = (np.abs(load) > SURE_LOAD * c.arm.torque_limit[j]) & c.is_later(c.transmission.trajectory)
    side = np.sign(load[sure]) * _twist_side(c, j, 0.5)[sure]
    return sure.sum() < SURE_ROWS or bool(side.mean() > ALIKE)


def _twist_range(c: Context, j: int) -> tuple[float, float]:
    """Middle of a joint's twist rad, and how far it goes to either side, in the recordings in which a play may show."""
    return _quantile_range(
        [w[:, j] for w, (number, _) in zip(c.transmission.wound, c.samples.grids) if c.is_later(number)]
    )


def _quantile_range(twists: list[np.ndarray]) -> tuple[float, float]:
    low, high = np.quantile(np.concatenate(twists), (EDGE, 1 - EDGE))
    return 0.5 * float(low + high), 0.5 * float(high - low)


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.transmission is None:
        return []
    floating = [
        EffectRegressor(
            "backlash",
            (Parameter("half_play", "rad", HALF_PLAY.lower, HALF_PLAY.upper, 1e-3, background=PLAY_KNOWN),),
            {Stage.TRANSMISSION: lambda c, j, share=share: stack(_twist_side(c, j, share))},
            "play operator: the twist shows at which side the gear is",
            f"floating, side sure at {100 * share:.0f} % of the twist's reach",
            only_joint=joint,
            model=FLOATING_MODEL,
        )
        for joint in range(len(context.arm))
        if _twist_range(context, joint)[1] > LEAST_REACH and _follows_load(context, joint)
        for share in SURE_AT
    ]
    return [
        *floating,
        EffectRegressor(
            "backlash",
            (Parameter("half_play", "rad", HALF_PLAY.lower, HALF_PLAY.upper, 1e-3, background=PLAY_KNOWN),),
            {Stage.TRANSMISSION: lambda c, j: stack(_load_side(c, j))},
            "play operator: the motor leads by half the play, whichever side drives",
        ),
    ]


EFFECT = Effect(
    "backlash",
    EffectTarget.JOINT,
    (HALF_PLAY,),
    _regressors,
    DetectionLimit("rad", (1e-4,) * 7, (1, 2, 3, 4, 5, 6, 7)),
    sentence_template="the gear of {at} has play: {half_play:mrad} to each side",
)

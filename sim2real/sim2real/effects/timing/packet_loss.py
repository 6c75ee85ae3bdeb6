"""Packet loss: a lost command leaves the last one in force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_common.rotations import namespace
from sim2real.effects import evidence
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import DriveFunction, DriveHook, DriveSlot, HookContext
from sim2real.effects.regressor import EffectRegressor, Parameter, stack
from sim2real.effects.stage import Stage
from sim2real.effects.timing.command_delay import delay_commands

SHARE = Quantity("share", "1", 0.0, 1.0)
LEAST_HELD = 20  # periods
ROUNDS = 20
SURE = 10.0  # nats by which holding must fit a period better than not holding


@dataclass(frozen=True, eq=False)
class LostPackets:
    """Periods in which the last command stayed in force."""

    held: np.ndarray
    """(n,) bool, those for certain."""
    excess: np.ndarray
    """(n,) nats by which holding fits each period better."""
    distinguishable: np.ndarray
    """(n,) bool, whether the command and the one before differ enough to decide."""

    def share(self, rows: np.ndarray) -> tuple[float, float]:
        """(share of some periods (n,) bool in which the command was held, its standard error: losses come by chance)."""
        counted = rows & self.distinguishable
        if counted.sum() > 100:
            found, count = _estimate_share(self.excess[counted]), counted.sum()
        else:
            found, count = float(self.held[rows].mean()) if rows.any() else 0.0, rows.sum()
        return found, float(np.sqrt(found * (1.0 - found) / max(count, 1)))


def hold_command(d: evidence.Drive, held: np.ndarray) -> np.ndarray:
    """Commands (n, k) in force when those of the periods `held` (n,) never arrived."""
    row = np.where(held, 0, np.arange(len(held)))
    return d.commanded[np.maximum.accumulate(row)]


def find_lost_packets(d: evidence.Drive) -> LostPackets:
    """The periods in which all joints show the command before instead of their own."""
    residual = d.measured - d.arrived
    spread = 1.4826 * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0)
    spread = np.maximum(spread, 1e-6)
    mean = np.median(residual, axis=0)
    scaled, command, arrived = (residual - mean) / spread, d.commanded / spread, d.arrived / spread
    free = 0.5 * np.square(scaled).sum(axis=1)
    held = np.zeros(len(residual), bool)
    # In a period whose command is lost the one before acts all the time; else until the new one has come.
    step = arrived - np.vstack([arrived[:1], command[:-1]])
    excess = free - 0.5 * np.square(scaled + step).sum(axis=1)
    distinguishable = 0.5 * np.square(step).sum(axis=1) > 2 * SURE
    begins = np.zeros(len(residual), bool)
    begins[d.starts] = True
    shown, late = scaled + arrived, d.late / d.period
    # Only periods that holding could explain at all are looked at one by one, and those after a held one.
    for first in np.flatnonzero((excess > SURE) & ~begins).tolist():
        if held[first] or held[first - 1]:
            continue
        last = command[first - 1]
        for i in range(first, len(residual)):
            if begins[i] and i > first:
                break
            # What is late after a lost command is the one before it: as if half lost itself, where that is forgotten.
            arrives = (1.0 - late) * command[i] + late * last
            excess[i] = 0.5 * (np.square(shown[i] - arrives).sum() - np.square(shown[i] - last).sum())
            if excess[i] <= SURE:
                break
            held[i] = True
    return LostPackets(held, np.where(held, np.inf, excess), distinguishable)


def _estimate_share(excess: np.ndarray) -> float:
    """Share of periods that are held, from the nats (n,) by which holding fits each better: each counts by its probability
    (the mixture's greatest likelihood, by expectation and maximisation: Dempster et al. 1977)."""
    share = float(np.clip((excess > 0).mean(), 1e-6, 0.5))
    for _ in range(ROUNDS):
        odds = np.clip(excess, -50.0, 50.0) + np.log(share / (1.0 - share))
        share = float(np.clip((1.0 / (1.0 + np.exp(-odds))).mean(), 1e-6, 0.5))
    return share


def _hold_change(c: Context, j: int) -> np.ndarray:
    """Change (n,) Nm of a joint's torque by the packets that were lost, the loop's own delay as without."""
    return delay_commands(c.drive, hold_command(c.drive, c.held)[:, j], c.drive.late) - c.drive.arrived[:, j]


def _regressors(context: Context) -> list[EffectRegressor]:
    # Of periods too alike to distinguish, none is lost for certain, so a share of them is not available.
    if context.drive is None or context.held is None or context.held.sum() <= LEAST_HELD or context.held_share <= 0:
        return []
    share, known = context.held_share, context.held_error
    return [
        EffectRegressor(
            "packet_loss",
            (Parameter("share", "1", 0.7 * share, 1.3 * share, 0.05 * share, share, background=known),),
            {Stage.DRIVE: lambda c, j: stack(_hold_change(c, j)) / share},
            "a lost command leaves the last one in force",
            is_arm=True,
            acts=share,
        )
    ]


def _lose_commands(values: HookContext) -> DriveFunction:
    share = values("share")
    share = namespace(share).amax(share, -1)[..., None]  # a packet holds the commands of all joints
    rng, last = np.random.default_rng(values.seed), None  # the same packets in all arms

    def drive(torque: np.ndarray) -> np.ndarray:
        nonlocal last
        last = torque if last is None else namespace(torque).where(share > rng.random(), last, torque)
        return last

    return drive


EFFECT = Effect(
    "packet_loss",
    EffectTarget.ARM,
    (SHARE,),
    _regressors,
    DetectionLimit("1", 0.01),
    drive=DriveHook(DriveSlot.ARRIVAL, _lose_commands),
    shows_in_motion=False,
    sentence_template="{share:%} of the commands are lost",
)

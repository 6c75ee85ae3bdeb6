"""timing: commands that come late or not at all (r1), measurements that are old (r2 or r0)."""

from __future__ import annotations

import numpy as np

from np_diagnosis.arm.stages import Drive
from np_diagnosis.effects.base import Context, Effect, Parameter, Shape, stack
from np_diagnosis.effects.torque_loop import WHOLE

USUAL = 4.5e-4  # s, up to which a delay of commands is what any loop has
DELAYS = tuple(
    1e-4 * 1.35**n for n in range(18)
)  # s beyond it: so fine that the best one leaves nothing to other effects
DELAY_LEAST = 3e-4  # s beyond what the loop has, up to which states may be older than they say
STEP_KNOWN = 2e-5  # s, to which a delay is known where commands are held for a period
STATE_KNOWN = 1e-4  # s, to which filtered motion tells one
LEAST_HELD = 20  # periods
SURE = 10.0  # nats by which holding must fit a period better than not holding


def effects(context: Context) -> list[Effect]:
    """Of the arm: every joint's command travels in one packet, every joint is measured at once."""
    found = [
        Effect(
            "measurement_delay",
            (Parameter("delay", "s", -0.05, 0.05, 0.004, background=STATE_KNOWN, least=DELAY_LEAST),),
            {"r2": _late_states},
            "states are older than their stamps",
            is_arm=True,
            absorbs="motion_delay",
        )
    ]
    if context.drive is None:
        return found
    found += [_delay(d) for d in DELAYS]
    found.append(
        Effect(
            "measurement_delay",
            (Parameter("delay", "s", -0.05, 0.05, 0.004, background=STATE_KNOWN, least=DELAY_LEAST),),
            {"r0": lambda c, j: stack(-_rate(c.drive, c.drive.law[:, j]))},
            "the controller acts on older states than it reports",
            "in the controller",
            is_arm=True,
        )
    )
    # Of periods too alike to tell, none is lost for certain: there is no share of those to go by.
    if context.held is not None and context.held.sum() > LEAST_HELD and context.held_share > 0:
        share = context.held_share
        known = float(np.sqrt(share * (1.0 - share) / max(context.held_seen, 1)))  # losses come by chance
        found.append(
            Effect(
                "packet_loss",
                (Parameter("share", "1", 0.7 * share, 1.3 * share, 0.05 * share, share, background=known),),
                {"r1": lambda c, j: stack(hold(c.drive, c.held)[:, j] - c.drive.commanded[:, j]) / share},
                "a lost command leaves the last one in force",
                is_arm=True,
            )
        )
    return found


def _late_states(c: Context, j: int) -> np.ndarray:
    """Rate (n, 1) Nm/s of all that the motion takes: gravity is compensated where the arm was, too."""
    rate = c.samples.torque_rate[:, j]
    if not c.samples.with_gravity:
        rate = rate + (c.prediction.gravity_slope[:, j] * c.samples.velocity).sum(axis=1)
    return stack(rate)


def delayed(d: Drive, values: np.ndarray, delay: float) -> np.ndarray:
    """values (n,) as they were `delay` s before; the first of each stretch before that."""
    whole, share = divmod(delay / d.period, 1.0)
    ends, late = [*d.starts[1:], len(values)], np.empty_like(values)
    for start, end in zip(d.starts, ends):
        part = values[start:end]
        padded = np.concatenate([np.full(int(whole) + 1, part[0]), part])[: len(part) + 1]
        late[start:end] = (1 - share) * padded[1:] + share * padded[:-1]
    return late


def hold(d: Drive, held: np.ndarray) -> np.ndarray:
    """Commands (n, k) in force when those of the periods `held` (n,) never arrived."""
    row = np.where(held, 0, np.arange(len(held)))
    return d.commanded[np.maximum.accumulate(row)]


def find_held(d: Drive) -> tuple[np.ndarray, float, int]:
    """(periods (n,) in which all joints show the command before instead of their own, their share of those in
    which the two differ enough to tell, the number of those)."""
    residual = d.measured - d.commanded
    spread = 1.4826 * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0)
    spread = np.maximum(spread, 1e-6)
    mean = np.median(residual, axis=0)
    scaled, command = (residual - mean) / spread, d.commanded / spread
    free = 0.5 * np.square(scaled).sum(axis=1)
    held = np.zeros(len(residual), bool)
    step = np.vstack([np.zeros(command.shape[1]), np.diff(command, axis=0)])
    excess = free - 0.5 * np.square(scaled + step).sum(axis=1)
    tellable = 0.5 * np.square(step).sum(axis=1) > 2 * SURE
    begins = np.zeros(len(residual), bool)
    begins[d.starts] = True
    # Only periods that holding could explain at all are looked at one by one, and those after a held one.
    for first in np.flatnonzero((excess > SURE) & ~begins).tolist():
        if held[first] or held[first - 1]:
            continue
        for i in range(first, len(residual)):
            change = command[first - 1] - command[i]
            if (begins[i] and i > first) or free[i] - 0.5 * np.square(scaled[i] - change).sum() <= SURE:
                break
            held[i] = True
    seen = int(tellable.sum())
    return (held, float(held[tellable].mean()), seen) if seen > 100 else (held, float(held.mean()), len(held))


def _delay(delay: float) -> Effect:
    """What a loop is late by beyond the usual, which is a nuisance's: of the two together nothing counts twice."""

    def columns(c: Context, j: int) -> np.ndarray:
        d, values = c.drive, c.drive.commanded[:, j]
        return stack(delayed(d, values, USUAL + delay) - delayed(d, values, USUAL))

    return Effect(
        "command_delay",
        (WHOLE,),
        {"r1": columns},
        "dead time between command and torque",
        f"{1e3 * delay:.3g} ms",
        # Not linear: what noise puts into the commands changes from period to period, and only the right delay meets it.
        Shape("delay", "s", delay, _delay, background=STEP_KNOWN),
        is_arm=True,
        absorbs="command_delay",
    )


def _rate(d: Drive, values: np.ndarray) -> np.ndarray:
    return np.concatenate([np.gradient(part, d.period) for part in np.split(values, d.starts[1:])])

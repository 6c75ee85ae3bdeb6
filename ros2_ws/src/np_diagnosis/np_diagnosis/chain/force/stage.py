"""Friction and mass by force: which of table and object explains what drags and pushes take.

A drag takes mu (N + m g), and so does a slow push, whose N is what the tip's friction holds the face down or up by. Pushes alone hold friction
and mass nearly as one product; drags that press by different forces tell them apart. A slow slide takes what the coefficient of a simulator
says, within 1.5 %: an error that all forces share, of friction and not of mass. Where a moving tip hops, as in MuJoCo with `HARD`, it takes 7 % less. The fingertip's coefficient is what strokes take that slip over a resting object, by different forces in the
same proportion. Else it is at least what it was seen to hold: a tip that hops, and an object that gives way under a scrape, take less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from np_description.camera import CAMERA, Camera
from np_description.domains import Domain
from np_description.panda import NOMINAL, PandaModel
from np_description.scene import contact_of
from np_diagnosis.chain.explanations import Explained, Measured, explain
from np_diagnosis.chain.force.readings import Reading, readings
from np_diagnosis.chain.force.slide import Slide, slides, slows
from np_diagnosis.chain.task.meeting import meet
from np_diagnosis.chain.task.recording import TaskRecording
from np_diagnosis.thresholds import THRESHOLDS

FORCE, SLIDE = THRESHOLDS.forcing, THRESHOLDS.tapping
GRAVITY = 9.81
NUMBERS = ("table", "mass", "finger")
"""Logarithms of coefficients and mass over those that are believed in."""
EFFECTS = {"table_friction": ("table",), "object_mass": ("mass",), "gripper_friction": ("finger",)}
UNKNOWN = 1.5  # standard deviation of such a logarithm before anything is known
TAILS = 1.5  # deviations from which on a reading counts less: now and then the tip slips, or the object tips


@dataclass(frozen=True)
class Believed:
    """Coefficient of the object with the table, its mass kg, and the coefficient with a fingertip."""

    table: float
    mass: float
    finger: float

    @classmethod
    def of(cls, domain: Domain) -> Believed:
        """What a domain says."""
        contact = contact_of(domain, domain.contact)
        return cls(contact.table, domain.mass, contact.finger)


@dataclass(frozen=True, eq=False)
class Forces:
    """verdict: as of Explained, or unexplained; doubt: why nothing is said. readings: that count. misfit: their errors over the usual ones.
    before, after: N, root mean square by which a reading is off when the other experiments tell friction and mass, without and with what is
    named. measured: coefficients `table` and `finger`, and `mass` kg, with 95 % intervals, of what was measured. least_finger: what the
    coefficient of the fingertip is at least, by what it held in drags and scrapes."""

    verdict: str
    explained: Explained | None
    readings: tuple[Reading, ...]
    doubt: str = ""
    misfit: float | None = None
    before: float | None = None
    after: float | None = None
    measured: dict[str, tuple[float, float, float]] | None = None
    least_finger: float | None = None


def weigh(recording: TaskRecording, panda: PandaModel = NOMINAL, camera: Camera = CAMERA) -> Forces:
    """Of a recording of the task suite. panda: the arm as it is; camera: over the table as it was felt, see `seen.over`."""
    slid = slides(recording, meet(recording, camera), camera)
    return judge(readings(recording, panda, camera), Believed.of(recording.domain), slid)


def judge(every: Sequence[Reading], believed: Believed, slid: Sequence[Slide] = ()) -> Forces:
    """Of readings: see `weigh`; slid: of objects that were tapped."""
    led = tuple(r for r in every if r.kind != "scrape" and r.follows >= FORCE.follows)
    if len(led) < 3:
        return Forces("undetermined", None, led, f"{len(led)} drags and pushes went as they should; 3 are needed")
    value, covariance, misfit = _fit(led, believed)
    covariance = np.maximum(1.0, _scattered(led, believed, covariance)) * covariance
    value, covariance = value - [FORCE.law[0], 0.0], covariance + np.diag([FORCE.law[1] ** 2, 0.0])
    value, covariance = _with_finger(value, covariance, every, believed)
    explained = explain(_measured(value, covariance))
    held = [
        (r.force - r.deviation) / (r.normal + r.normal_deviation) for r in every if r.kind == "scrape" or _is_led(r)
    ]
    before, after = _held_out(led, believed, {one.effect for one in explained.named})
    told = dict(
        readings=led,
        misfit=misfit,
        before=before,
        after=after,
        measured=_sizes(value, covariance, believed),
        least_finger=max(held, default=None),
    )
    if doubt := _pulled(led, believed) or _pressed(told["measured"], slid):
        return Forces("unexplained", explained, doubt=doubt, **told)
    if misfit > FORCE.misfit:
        return Forces(
            "unexplained", explained, doubt=f"forces are {misfit:.1f} times as far off as they usually are", **told
        )
    return Forces(explained.verdict, explained, **told)


def _with_finger(
    value: np.ndarray, covariance: np.ndarray, every: Sequence[Reading], believed: Believed
) -> tuple[np.ndarray, np.ndarray]:
    """The numbers with the fingertip's, which is unknown unless strokes slip over an object that rests, all in one proportion."""
    slips = [r for r in every if r.kind == "drag" and abs(r.follows) < FORCE.slips]
    logs = np.array([np.log(max(r.force, 1e-3) / r.normal) for r in slips])
    finger, variance = 0.0, UNKNOWN**2
    if len(slips) > 1 and np.ptp(logs) < FORCE.proportion:
        own = np.array([np.hypot(r.deviation / r.force, r.normal_deviation / r.normal) for r in slips]) ** 2
        mean = float(np.average(logs, weights=1 / own))
        if not hops(every, np.exp(mean), *np.exp(value) * (believed.table, believed.mass)):
            finger = mean - np.log(believed.finger)
            variance = float(1 / np.sum(1 / own)) + FORCE.proportion**2 / 4 / len(slips)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[2, 2] = covariance, variance
    return np.append(value, finger), whole


def hops(every: Sequence[Reading], finger: float, table: float, mass: float) -> bool:
    """Whether tips with coefficient `finger` are not what slips: pressed by more than an object of such a mass on such a table resists, they would
    hold it and lead it along, and strokes by more lead it a part of the way. One that leads it nowhere slips, and is of that proportion itself."""
    holds = table * mass * GRAVITY / max(finger - table, 1e-3)
    more = [r for r in every if r.kind == "drag" and r.normal > FORCE.surely * holds]
    return sum(FORCE.slips <= r.follows < FORCE.follows for r in more) > 1


def _is_led(reading: Reading) -> bool:
    return reading.kind == "drag" and reading.follows >= FORCE.follows


def _predicted(numbers: np.ndarray, used: Sequence[Reading], believed: Believed) -> np.ndarray:
    """Forces (n,) N of the readings with numbers (2,), the first two of NUMBERS."""
    table, mass = np.exp(numbers) * (believed.table, believed.mass)
    return np.array([table * (r.normal + mass * GRAVITY) for r in used])


def _fit(
    used: Sequence[Reading], believed: Believed, free: Sequence[int] = (0, 1)
) -> tuple[np.ndarray, np.ndarray, float]:
    """Numbers (2,), covariance (2, 2), and errors over usual ones; numbers that are not free stay as believed.

    Nuisances are what each group's forces, and what normal forces of each, have in common."""
    force = np.array([r.force for r in used])
    own = np.array([np.hypot(r.deviation, believed.table * r.normal_deviation) for r in used])
    names = list(dict.fromkeys(r.group for r in used))
    member = np.array([[r.group == name for name in names] for r in used], float)
    places = list(free)

    def left(x: np.ndarray) -> np.ndarray:
        numbers, common = np.zeros(2), x[len(places) :]
        numbers[places] = x[: len(places)]
        return (force - _predicted(numbers, used, believed) - FORCE.common * member @ common) / own

    def off(x: np.ndarray) -> np.ndarray:
        return np.concatenate([left(x), x[: len(places)] / UNKNOWN, x[len(places) :]])

    found = least_squares(off, np.zeros(len(places) + len(names)), loss="soft_l1", f_scale=TAILS)
    errors = np.abs(left(found.x))
    misfit = 1.4826 * float(np.median(errors)) * np.sqrt(len(used) / max(len(used) - len(places), 1))
    inverse = np.linalg.inv(found.jac.T @ found.jac) * _scale(misfit, len(used) - len(places))
    numbers, covariance = np.zeros(2), np.zeros((2, 2))
    numbers[places] = found.x[: len(places)]
    covariance[np.ix_(places, places)] = inverse[: len(places), : len(places)]
    return numbers, covariance, misfit


def _scale(misfit: float, left: int) -> float:
    """Factor of the variance of what readings say, by how far off they are in this recording: usual errors are what nobody has seen more of, and
    count as some readings more, beside `left` that no number takes."""
    return float((FORCE.usually + max(left, 0) * misfit**2) / (FORCE.usually + max(left, 0)))


def _pulled(used: Sequence[Reading], believed: Believed) -> str:
    """What pulls the object beside the hand, if forces are more probable with it; "" for nothing. Along the table, it takes from readings in
    some directions what it gives to others; downwards, more at one place than at another, it is no mass."""
    ways, places = np.array([r.way for r in used]), np.array([r.place for r in used])
    pull, gain = _with_more(used, believed, -ways)
    if gain > FORCE.pulled and np.linalg.norm(pull) > FORCE.pull:
        return f"something pulls the object by {pull[0]:.2f} N and {pull[1]:.2f} N (x, y), whatever the hand does"
    away = places - places.mean(axis=0)
    down, gain = _with_more(used, believed, believed.table * away / FORCE.apart)
    differs = float(np.ptp(away / FORCE.apart @ down))
    if gain > FORCE.pulled and differs > FORCE.pull:
        return f"the object is pulled down by {differs:.1f} N more at one place than at another"
    return ""


def _pressed(measured: Mapping[str, tuple[float, float, float]], slid: Sequence[Slide]) -> str:
    """What presses the object onto the table and is no weight, if all slides end sooner than friction has it; "" for nothing."""
    if len(slid) < SLIDE.least or not {"table", "mass"} <= set(measured):
        return ""
    friction, low, high = (GRAVITY * value for value in measured["table"])
    deviations = [np.hypot(SLIDE.face, (one.short(low) - one.short(high)) / 3.92) for one in slid]
    if min(one.short(friction) / own for one, own in zip(slid, deviations)) < SLIDE.sooner:
        return ""
    # Pushes and drags tell weight and the rest together; of what slows an object by its own weight, mass is no part.
    pressed = (1 - friction / slows(slid)) * measured["mass"][0] * GRAVITY
    return (
        f"about {pressed:.1f} N of what presses the object onto the table are no weight: it stops sooner when it slides"
    )


def _with_more(used: Sequence[Reading], believed: Believed, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Numbers (2,) by which forces that go with columns (n, 2) are larger, and nats by which readings are more probable with them."""
    force = np.array([r.force for r in used])
    own = np.array([np.hypot(r.deviation, believed.table * r.normal_deviation) for r in used])

    def off(x: np.ndarray) -> np.ndarray:
        left = (force - _predicted(x[:2], used, believed) - columns @ x[2:]) / np.hypot(own, FORCE.common)
        return np.concatenate([left, x[:2] / UNKNOWN])

    more = least_squares(off, np.zeros(4), loss="soft_l1", f_scale=TAILS)
    without = least_squares(lambda x: off(np.append(x, [0.0, 0.0])), np.zeros(2), loss="soft_l1", f_scale=TAILS)
    return more.x[2:], float(without.cost - more.cost)


def _scattered(used: Sequence[Reading], believed: Believed, covariance: np.ndarray) -> float:
    """By how much the variance of the numbers is larger, by a jackknife over experiments, than readings' own errors say."""
    names = list(dict.fromkeys(r.experiment for r in used))
    if len(names) < 3:
        return 1.0
    without = np.array([_fit([r for r in used if r.experiment != name], believed)[0] for name in names])
    spread = (len(names) - 1) * np.var(without, axis=0)
    return float(np.max(spread / np.diag(covariance)))


def _measured(value: np.ndarray, covariance: np.ndarray) -> Measured:
    usual, gap = zip(FORCE.table, FORCE.mass, FORCE.finger)
    return Measured(NUMBERS, value, covariance, np.array(usual), np.array(gap), EFFECTS)


def _held_out(used: Sequence[Reading], believed: Believed, named: set[str]) -> tuple[float, float]:
    free = [k for k, effect in enumerate(("table_friction", "object_mass")) if effect in named]
    before, after = [], []
    for name in dict.fromkeys(r.experiment for r in used):
        mine, others = [r for r in used if r.experiment == name], [r for r in used if r.experiment != name]
        force = np.array([r.force for r in mine])
        value = _fit(others, believed, free)[0] if others else np.zeros(2)
        before += list(force - _predicted(np.zeros(2), mine, believed))
        after += list(force - _predicted(value, mine, believed))
    return float(np.sqrt(np.mean(np.square(before)))), float(np.sqrt(np.mean(np.square(after))))


def _sizes(value: np.ndarray, covariance: np.ndarray, believed: Believed) -> dict[str, tuple[float, float, float]]:
    """Value and interval of each coefficient and of the mass, of those that were measured at all."""
    found = {}
    for k, name in enumerate(NUMBERS):
        deviation = float(np.sqrt(covariance[k, k]))
        if deviation < 0.5 * UNKNOWN:
            scale = getattr(believed, name)
            found[name] = tuple(float(scale * np.exp(value[k] + step * deviation)) for step in (0.0, -1.96, 1.96))
    return found

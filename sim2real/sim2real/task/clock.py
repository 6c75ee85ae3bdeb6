"""Do two streams of one body tell the same time? Offset and drift of the second's stamps against the first's.

Angular speeds, which no frame changes, say where to look; turns (`chain.alignment`) say how much. What is no single delay
is not given out as one: motion that repeats itself, motion that says too little, thirds of a recording or quick and slow
motion that disagree.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim2real.recordings.reading import ContractViolation
from sim2real.task.alignment import Alignment, align, turn
from sim2real.task.course import Course, course
from sim2real.task.frames import Frames, frames
from sim2real.task.streams import Stream
from sim2real.thresholds import THRESHOLDS

CLOCK = THRESHOLDS.clock
LATENCY, OFF, DROP = "camera_latency", "clock_offset", "frame_drop"


@dataclass(frozen=True)
class Value:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float

    def holds(self, true: float) -> bool:
        """Whether the interval holds a number."""
        return bool(self.low <= true <= self.high)

    def __neg__(self) -> Value:
        return Value(-self.value, -self.high, -self.low)


@dataclass(frozen=True)
class Clock:
    """The answer. offset: s by which the second stream's stamps are late, in the middle of the recording; drift: ppm by which
    they become later; both None where the recording does not tell, for the reason in `doubt`. thirds: offset in each third,
    by itself; paces: over short and over long turns. middle: s on the first stream's clock, where the offset is that. rivals: s, offsets that explain the recording as well. agreement
    (offsets (k,) s, correlation of the angular speeds (k,))."""

    names: tuple[str, str]
    frames: tuple[Frames, Frames]
    offset: Value | None = None
    drift: Value | None = None
    drift_is_sure: bool = False
    thirds: tuple[Value | None, ...] = ()
    paces: tuple[Value | None, ...] = ()
    middle: float | None = None
    rivals: tuple[float, ...] = ()
    doubt: str = ""
    agreement: tuple[np.ndarray, np.ndarray] = field(default=(np.zeros(0), np.zeros(0)), compare=False)

    @property
    def verdict(self) -> str:
        """As in the reports on the arm; `undetermined` where the recording does not tell."""
        if self.offset is None:
            return "undetermined"
        if self.doubt:
            return "unexplained"
        if self.drift_is_sure:
            return "identified"
        return "no_gap" if self.is_small else "ambiguous"

    @property
    def is_small(self) -> bool:
        """Whether the offset may be none, or is too small to matter."""
        return self.offset.holds(0.0) or abs(self.offset.value) < CLOCK.matters

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that are named. One offset is a class of two: no single recording says whether a picture came late or
        its clock is off. A picture does not come before it was taken."""
        found = ()
        if self.verdict == "identified" or (self.verdict == "ambiguous" and self.offset.value < 0):
            found = (OFF,)
        elif self.verdict == "ambiguous":
            found = (LATENCY, OFF)
        return found + ((DROP,) if any(f.is_dropping for f in self.frames) else ())


def compare(a: Stream, b: Stream, within: float = CLOCK.within) -> Clock:
    """The clock of b against that of a, two streams of one rigid body; offsets are sought within so many s to either side.

    Raises ContractViolation for streams that have too little time in common.
    """
    zero = a.time[0]
    a, b = a.shifted(-zero), b.shifted(-zero)
    common = min(a.time[-1], b.time[-1]) - max(a.time[0], b.time[0])
    if common < CLOCK.overlap:
        raise ContractViolation(
            f"{a.name}, {b.name}: expected at least {CLOCK.overlap:g} s in common, got {max(common, 0.0):.3g} s; "
            "their stamps must be of about the same time"
        )
    of_a, of_b = course(a), course(b)
    if of_a.density <= of_b.density:  # the quieter one is interpolated
        found = _compare(of_a, of_b, b, within, 1.0)
    else:
        found = _compare(of_b, of_a, a, within, -1.0)
    if "middle" in found:
        found["middle"] = float(zero + found["middle"])
    return Clock((a.name, b.name), (frames(a), frames(b)), **found)


def _compare(reference: Course, other: Course, measured: Stream, within: float, sign: float) -> dict:
    """The fields of a `Clock` that a comparison fills. sign: -1 where the course is that of the second stream."""
    turned, noise = turn(measured), np.sqrt(6) * other.noise  # two poses make a turn, and it has three axes
    if turned < CLOCK.noise * noise:
        size, alone = (f"{np.degrees(value):.2g}" for value in (turned, noise))
        return {
            "doubt": f"the body hardly turns, {size} degrees in {CLOCK.span:g} s, of which noise alone makes {alone}; "
            "turn it to and fro about two axes"
        }
    offsets, agreement = speeds(reference, other, measured, within)
    found = {"agreement": (sign * offsets, agreement)}
    peaks = _peaks(offsets, agreement)
    fits = _distinct([fit for start in peaks if (fit := align(reference, measured, start))], within)
    if not fits:
        return found | {"doubt": _apart(within)}
    best = fits[0]
    rivals = tuple(fit for fit in fits[1:] if not _leads(best, fit))
    if doubt := _unheard(best, rivals, within):
        return found | {"doubt": doubt, "rivals": tuple(sign * fit.offset for fit in rivals)}
    offset, drift = best.half_widths()
    thirds = _thirds(reference, measured, best)
    paces = tuple(align(reference, measured, best.offset, span, best.is_inverse, False) for span in CLOCK.spans)
    parts = [_value(fit, sign) for fit in (*thirds, *paces)]
    value = _value(best, sign)
    sure = float(best.half_widths(CLOCK.sure)[1])
    doubt = _disagreement(best, thirds, paces, sign)
    if doubt:  # the interval holds what the parts say: it is not one delay
        told = [part.value for part in parts if part]
        value = Value(value.value, min(value.low, *told), max(value.high, *told))
    rate = sign * best.drift
    return found | {
        "offset": value,
        "drift": Value(*(float(1e6 * ppm) for ppm in (rate, rate - drift, rate + drift))),
        "drift_is_sure": abs(rate) > sure,
        "thirds": tuple(parts[:3]),
        "paces": tuple(parts[3:]),
        "middle": (measured.time[0] + measured.time[-1]) / 2 - (best.offset if sign > 0 else 0.0),
        "doubt": doubt,
    }


def speeds(reference: Course, other: Course, measured: Stream, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (k,) s and the correlation (k,) of the two angular speeds there, NaN where too little is common."""
    steps = int(round(within / CLOCK.step))
    offsets = np.arange(-steps, steps + 1) * CLOCK.step
    time = np.arange(measured.time[0], measured.time[-1], CLOCK.step)
    ahead = np.arange(time.size + 2 * steps) * CLOCK.step + time[0] - steps * CLOCK.step
    seen, true = other.speed(time), reference.speed(ahead)
    found = np.full(offsets.size, np.nan)
    for k in range(offsets.size):
        part = true[2 * steps - k : 2 * steps - k + time.size]
        both = np.isfinite(part) & np.isfinite(seen)
        if both.sum() * CLOCK.step >= CLOCK.overlap and np.std(part[both]) and np.std(seen[both]):
            found[k] = np.corrcoef(part[both], seen[both])[0, 1]
    return offsets, found


def _peaks(offsets: np.ndarray, agreement: np.ndarray) -> np.ndarray:
    """Offsets (m,) s at which speeds agree best, the best first."""
    value = np.nan_to_num(agreement, nan=-1.0)
    around = np.r_[-2.0, value, -2.0]
    top = np.flatnonzero((value > max(CLOCK.peak * value.max(), 0.0)) & (value >= around[:-2]) & (value >= around[2:]))
    return offsets[top[np.argsort(-value[top])][: CLOCK.peaks]]


def _distinct(fits: list[Alignment], within: float) -> list[Alignment]:
    """Those that differ and lie within the search, the likeliest first."""
    kept = []
    for fit in sorted(fits, key=lambda f: -np.nanmean(f.density)):
        near = any(abs(fit.offset - other.offset) < CLOCK.apart for other in kept)
        if abs(fit.offset) <= within + CLOCK.apart and not near:
            kept.append(fit)
    return kept


def _leads(best: Alignment, other: Alignment) -> bool:
    """Whether the first explains the recording clearly better. Every row is in two pairs, so that a pair counts half."""
    gain = (best.density - other.density) / 2
    known = np.isfinite(gain)
    _, block = np.unique(best.time[known] // CLOCK.block, return_inverse=True)
    blocks = np.bincount(block, gain[known])
    error = np.sqrt(blocks.size * np.var(blocks, ddof=1)) if blocks.size > 1 else np.inf
    return blocks.sum() > max(CLOCK.decisive, CLOCK.gain_errors * error)


def _unheard(best: Alignment, rivals: tuple[Alignment, ...], within: float) -> str:
    """Why a recording does not tell, "" where it does."""
    if best.share < CLOCK.together:
        return _apart(within)
    if rivals:
        others = ", ".join(f"{1e3 * abs(fit.offset - best.offset):.0f}" for fit in rivals)
        return f"the motion repeats itself: offsets {others} ms away explain it as well; move at changing speed"
    half = best.half_widths()[0]
    if not half < CLOCK.sharp:
        return (
            f"the motion says too little: 95 % of offsets lie within {1e3 * half:.0f} ms to either side; "
            "it must change its angular velocity more often"
        )
    return ""


def _apart(within: float) -> str:
    return (
        f"the two streams do not turn together within {within:g} s: they are not of one rigid body, the offset is larger, a "
        "quaternion is not in the order x y z w, or too little of them lies side by side without gaps"
    )


def _thirds(reference: Course, measured: Stream, best: Alignment) -> tuple[Alignment | None, ...]:
    """The offset of each third of the measured stream, by itself."""
    edges = np.quantile(best.time[np.isfinite(best.density)], [0, 1 / 3, 2 / 3, 1])
    parts = [measured.rows((measured.time >= low) & (measured.time < high)) for low, high in zip(edges, edges[1:])]
    return tuple(
        align(reference, part, best.offset, is_inverse=best.is_inverse, with_drift=False) if len(part.time) else None
        for part in parts
    )


def _value(fit: Alignment | None, sign: float) -> Value | None:
    if fit is None:
        return None
    offset, half = sign * fit.offset, fit.half_widths()[0]
    return Value(float(offset), float(offset - half), float(offset + half))


def _disagreement(
    best: Alignment, thirds: tuple[Alignment | None, ...], paces: tuple[Alignment | None, ...], sign: float
) -> str:
    """In which way the offset is not one, "" where it is."""
    span = np.ptp(best.time[np.isfinite(best.density)])
    for place, third in zip((-1 / 3, 0.0, 1 / 3), thirds):
        if third and _differ(third, best.offset + best.drift * place * span, best):
            return "a third of the recording has another offset than the others, as if the clock had jumped"
    quick, slow = paces
    if quick and slow and _differ(quick, slow.offset, slow):
        each = f"{1e3 * sign * quick.offset:.1f} ms over quick turns, {1e3 * sign * slow.offset:.1f} ms over slow ones"
        return (
            f"the offset is no single delay: {each}; look at a filter, at the exposure, at rows read one after another"
        )
    return ""


def _differ(fit: Alignment, offset: float, other: Alignment) -> bool:
    # A few blocks of motion make an error that is itself unsure: Student's interval, in standard errors of a normal one.
    error = np.hypot(fit.half_widths()[0], other.half_widths()[0]) / 1.96
    return abs(fit.offset - offset) > max(CLOCK.differs * error, CLOCK.matters)

"""What two clocks were found to do, in words and as what stands in a JSON file."""

from __future__ import annotations

from dataclasses import asdict

from sim2real.task.clock import CLOCK, OFF, Clock, Value
from sim2real.task.frames import Frames


def sentence(clock: Clock) -> str:
    """Offset and drift with what they may mean; or why the recording does not tell; frames that are missing."""
    a, b = clock.names
    if clock.offset is None:
        parts = [f"The recording does not tell how the stamps of {b} lie to those of {a}: {clock.doubt}."]
    else:
        parts = [_said(clock)]
        if clock.doubt:
            parts.append(f"But {clock.doubt}.")
        parts.append(_drift(clock))
    return " ".join([*parts, *(_dropped(n, f) for n, f in zip(clock.names, clock.frames) if f.is_dropping)])


def document(clock: Clock) -> dict:
    """The answer as JSON holds it: s, ppm, intervals of 95 %; null where the recording does not tell."""
    return {
        "verdict": clock.verdict,
        "effects": list(clock.effects),
        "sentence": sentence(clock),
        "offset_s": _number(clock.offset),
        "offset_ci95_s": _interval(clock.offset),
        "drift_ppm": _number(clock.drift),
        "drift_ci95_ppm": _interval(clock.drift),
        "at_s": clock.middle,
        "thirds": [{"offset_s": _number(third), "ci95_s": _interval(third)} for third in clock.thirds],
        "quick_and_slow": [{"offset_s": _number(pace), "ci95_s": _interval(pace)} for pace in clock.paces],
        "rivals_s": [float(rival) for rival in clock.rivals],
        "doubt": clock.doubt,
        "frames": {name: asdict(found) | {"drops": found.is_dropping} for name, found in zip(("a", "b"), clock.frames)},
        "streams": list(clock.names),
    }


def _said(clock: Clock) -> str:
    a, b = clock.names
    late, how = (clock.offset, "late") if clock.offset.value > 0 else (-clock.offset, "early")
    size = f"{1e3 * late.value:.1f} ms {how}"
    bounds = f"95 %: {_span(late, 1e3)} ms"
    if clock.verdict == "no_gap":
        return f"The stamps of {b} agree with those of {a}: {size} ({bounds})."
    said = f"The stamps of {b} are {size} against those of {a} ({bounds})."
    if clock.verdict == "ambiguous" and clock.effects[0] == OFF:
        return f"{said} No picture comes before it was taken: its clock is off, or it is {a} that is late."
    if clock.verdict == "ambiguous":
        return (
            f"{said} A picture that comes late and a clock that is off look the same here; a drift or a second clock would "
            "split them."
        )
    return said


def _drift(clock: Clock) -> str:
    span = _span(clock.drift, 1.0)
    if clock.drift_is_sure and not clock.doubt:
        return f"They drift by {clock.drift.value:.0f} ppm ({span}): these are two clocks, which no latency explains."
    return f"They drift by {span} ppm, which may be none."


def _dropped(name: str, found: Frames) -> str:
    return (
        f"Of the frames of {name} {100 * found.missing:.0f} % are missing and {100 * found.repeated:.0f} % repeated; "
        f"the longest gap is {found.longest_gap:.2f} s."
    )


def _span(value: Value, scale: float) -> str:
    digits = 1 if scale == 1e3 else 0
    return f"{scale * value.low:.{digits}f} to {scale * value.high:.{digits}f}"


def _number(value: Value | None) -> float | None:
    return None if value is None else float(value.value)


def _interval(value: Value | None) -> list[float] | None:
    return None if value is None else [float(value.low), float(value.high)]


SCOPE = (
    f"Offsets below {1e3 * CLOCK.matters:.0f} ms are none. Rows that are read one after another and the exposure are not looked "
    "for: an offset is that of the moment that a pose is of, usually the middle of the exposure."
)

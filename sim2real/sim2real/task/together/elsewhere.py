"""Answers that other commands gave of the same set-up: what `diagnose`, `clock` and `pushes` wrote, as rows and claims of the chain."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sim2real.effects import VIEW_RECORDS
from sim2real.effects.saying import Value, say
from sim2real.recordings.reading import ContractViolation
from sim2real.task.together.claims import Claim, Way, late_by, nats


@dataclass(frozen=True)
class Answer:
    """stage: arm, clock or pushes; module: that its verdict is about; verdict: as of a row of the chain; said: its finding in words, where
    there is no claim; doubt: why nothing is said, or what nothing explains."""

    stage: str
    module: str
    verdict: str
    claims: tuple[Claim, ...] = ()
    said: str = ""
    doubt: str = ""

    @property
    def is_seen(self) -> bool:
        """Whether a gap would have shown."""
        return self.verdict in ("no_gap", "identified", "ambiguous")


def of_arm(folder: str | Path) -> Answer:
    """From the folder that `diagnose` wrote. Raises ContractViolation where its report is not there or is none."""
    told = _read(Path(folder) / "report.json", "arm", "diagnose", ("verdict", "sentence"))
    return Answer("arm", "arm", str(told["verdict"]), said=str(told["sentence"]))


def of_clock(folder: str | Path) -> Answer:
    """From the folder that `clock` wrote, of the camera's stream against another one. Raises ContractViolation."""
    told = _read(Path(folder) / "clock.json", "clock", "clock", ("verdict", "effects", "sentence", "doubt", "offset_s"))
    claims = ()
    if told["verdict"] in ("identified", "ambiguous"):
        late = _value(told, "offset_s", "offset_ci95_s")
        ways = tuple(way for way in late_by(late) if way.name in told["effects"])
        if told["verdict"] == "identified":  # by its drift
            ppm = _value(told, "drift_ppm", "drift_ci95_ppm")
            ways = (_off(late, Value(*(1e-6 * number for number in (ppm.value, ppm.low, ppm.high)))),)
        claims = (Claim("clock", ways, nats(late)),)
    return Answer(
        "clock", "timing", told["verdict"], claims, "" if claims else str(told["sentence"]), str(told["doubt"])
    )


def of_pushes(file: str | Path) -> Answer:
    """From the file that `pushes --out` wrote: what is other in all new pushes. Raises ContractViolation."""
    told = _read(Path(file), "pushes", "pushes", ("new_together",))["new_together"]
    named, verdict = told["named"], told["verdict"]
    claims = tuple(Claim("pushes", _pushed(one), float(one["gain_nats"])) for one in named)
    if verdict == "unexplained":
        return Answer("pushes", "contact", verdict, doubt="pushes are off what any effect explains")
    if not claims:
        return Answer("pushes", "contact", "no_gap", said="Slow pushes are as those of the reference.")
    return Answer("pushes", "contact", "identified" if all(one.is_one for one in claims) else "ambiguous", claims)


def _pushed(one: Mapping) -> tuple[Way, ...]:
    sizes = {
        size["field"]: Value(*(float(size[key]) - bool(size["is_factor"]) for key in ("value", "low", "high")))
        for size in one["sizes"]
    }
    ids = tuple(one["effect"])
    parts = [
        f"{sizes[size['field']]:% more/less}" if size["is_factor"] else f"{sizes[size['field']]:SI}"
        for size in one["sizes"]
    ]
    said = f"slow pushes show {' or '.join(_words(i) for i in ids)}: {', '.join(parts)}"
    first = Way("/".join(ids), ids, sizes, said, {})
    rivals = (tuple(rival) for rival in one["rivals"])
    return (first, *(Way("/".join(r), r, {}, " or ".join(map(_words, r)), {}) for r in rivals))


def _words(effect: str) -> str:
    return effect.replace("_", " ")


def _off(late: Value, drift: Value) -> Way:
    sizes = {"offset": late, "drift": drift}
    said = say(VIEW_RECORDS["clock_offset"], "camera", sizes, "the simulator")
    return Way("clock_offset", ("clock_offset",), sizes, said, {name: value.value for name, value in sizes.items()})


def _value(told: Mapping, name: str, interval: str) -> Value:
    return Value(float(told[name]), *map(float, told[interval]))


def _read(path: Path, what: str, command: str, keys: tuple[str, ...]) -> dict:
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        missing = [key for key in keys if key not in told]
    except (OSError, ValueError, TypeError) as error:
        got = getattr(error, "strerror", None) or error
        raise ContractViolation(f"{what} {path}: expected what `{command}` wrote, got: {got}") from error
    if missing:
        raise ContractViolation(f"{what} {path}: expected what `{command}` wrote, got no {missing[0]}")
    return told

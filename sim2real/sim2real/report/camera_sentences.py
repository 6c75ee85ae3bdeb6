"""What the view stage found, in words and as what stands in a JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from sim2real.effects import CAMERA_EFFECTS
from sim2real.effects.sentences import ValueWithInterval
from sim2real.task.camera.diagnosis import CameraDiagnosis
from sim2real.task.camera.parameters import BY_NAME, EFFECTS, PARAMETERS, SHOWN_BY, distinguishing_experiments
from sim2real.task.hypotheses import TaskFinding

PUT_DOWN = "the object put down at eight places, all over the picture"


def sentences(view: CameraDiagnosis) -> list[str]:
    """The finding; what distinguishes its members; what it is worth; what was left out; what the recording does not show."""
    parts = [_verdict(view)]
    if view.verdict in ("identified", "ambiguous"):
        parts += [_capital(_alternatives(one)) for one in view.findings]
        held = view.held_out
        parts.append(
            f"At places that were not fitted a corner is {held.before:.1f} px from its nominal place, and {held.after:.1f} px "
            "from where this puts it."
        )
    if view.left_out:
        parts.append(f"Left out, as the object does not lie flat there: {', '.join(view.left_out)}.")
    if view.bounds and view.unidentifiable and view.verdict != "unexplained":
        parts.append(
            f"Not narrowed by this recording: {', '.join(BY_NAME[name].text for name in view.unidentifiable)}."
        )
    if experiments := next_steps(view):
        parts.append(f"More would be shown by: {'; '.join(experiments)}.")
    return parts


def next_steps(view: CameraDiagnosis) -> list[str]:
    """Experiments that distinguish rivals, or show what the recording does not; each once, none where nothing is open."""
    if view.verdict == "unexplained":
        return []
    if not view.bounds:  # too few places for anything
        blind = [] if view.scene.measured.any() else ["camera_place", "table_height"]
        return [PUT_DOWN, *(SHOWN_BY[name] for name in blind)]
    experiments = [text for one in view.findings for text in _split_by(one)]
    if not view.findings:
        hidden = (n for n, e in EFFECTS.items() if all(PARAMETERS[i].name in view.unidentifiable for i in e.numbers))
        experiments += [SHOWN_BY[name] for name in hidden]
    return list(dict.fromkeys(experiments))


def document(view: CameraDiagnosis) -> dict:
    """The result as the JSON report holds it: SI units, px in images, intervals of 95 %; `effects` as `patch.yaml` has them."""
    return {
        "verdict": view.verdict,
        "effects": patch(view),
        "sentences": sentences(view),
        "places": view.places,
        "left_out": list(view.left_out),
        "off_px": view.off,
        "named": [_finding(one) for one in view.findings],
        "gains_nats": view.gains,
        "bounds": _values(view.bounds),
        "unseen": list(view.unidentifiable),
        "scatter_px": view.scatter[0] if view.scatter else None,
        "scatter_without_px": view.scatter[1] if view.scatter else None,
        "held_out": asdict(view.held_out) if view.held_out else None,
        "doubt": view.abstention_reason,
        "next": next_steps(view),
    }


def patch(view: CameraDiagnosis) -> list[dict]:
    """Entries of `patch.yaml`: findings with one hypothesis that a simulated camera models."""
    entries: dict[str, dict] = {}
    for one in view.findings if view.verdict in ("identified", "ambiguous") else ():
        best = one.hypotheses[0]
        if len(one.hypotheses) > 1 or not best.patch:
            continue
        record = CAMERA_EFFECTS[best.effects[0]]
        entry = {"effect": record.id, "component": str(record.target), "parameters": {}}
        entries.setdefault(record.id, entry)["parameters"].update(best.patch)
    return list(entries.values())


def _split_by(one: TaskFinding) -> tuple[str, ...]:
    """Experiments that distinguish the hypotheses of a finding."""
    return distinguishing_experiments(frozenset(hypothesis.name for hypothesis in one.hypotheses))


def _verdict(view: CameraDiagnosis) -> str:
    off = "" if view.off is None else f" ({view.off:.1f} px off)"
    corners = f"at {view.places} places corners are"
    if view.verdict == "unexplained":
        return f"No known effect explains where corners are seen{off}: {view.abstention_reason}."
    if view.verdict == "undetermined":
        return f"The recording does not show whether corners are where they should be{off}: {view.abstention_reason}."
    if view.verdict == "no_gap":
        return f"As far as this recording shows, {corners} at their nominal places{off}."
    return f"{_capital(corners)} not at their nominal places{off}."


def _alternatives(one: TaskFinding) -> str:
    """A finding with all its hypotheses, each with the sizes that it has where it stands alone."""
    texts = [effect_text(hypothesis.name, hypothesis.estimates) for hypothesis in one.hypotheses]
    return f"{texts[0]}." if len(texts) == 1 else f"either {'; or '.join(texts)}."


def effect_text(effect: str, sizes: Mapping[str, ValueWithInterval]) -> str:
    """An effect in words, as half a sentence; a number that the recording does not narrow is a question mark."""
    unknown = {name for name, value in sizes.items() if not BY_NAME[name].is_informative(value.low, value.high)}
    if unknown == sizes.keys():
        return f"{EFFECTS[effect].called} is off, by how much this recording does not show"
    values = {name: _Unknown() if name in unknown else value for name, value in sizes.items()}
    return EFFECTS[effect].text.format(**values).replace("  ", " ")


class _Unknown:
    """Stands for an unknown number."""

    def __format__(self, spec: str) -> str:
        unit = spec.partition(" ")[0]
        return f"? {unit}".strip()


def _finding(one: TaskFinding) -> dict:
    best, *rivals = one.hypotheses
    return {
        "name": best.name,
        "effect": list(best.effects),
        "gain_nats": one.log_bayes_factor,
        "sizes": _values(best.estimates),
        "rivals": [{"name": r.name, "effect": list(r.effects), "sizes": _values(r.estimates)} for r in rivals],
        "split_by": list(_split_by(one)),
    }


def _values(values: Mapping[str, ValueWithInterval]) -> dict[str, dict[str, float]]:
    return {name: asdict(value) for name, value in values.items()}


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]

"""What was found, first of all: one or two sentences for who reads no table."""

from __future__ import annotations

from sim2real.diagnosis import Diagnosis, Finding
from sim2real.effects import RECORDS
from sim2real.effects.record import Place
from sim2real.effects.saying import Value, place, say

_COUNT = {1: "it", 2: "both", 3: "all three"}


def sentence(diagnosis: Diagnosis) -> str:
    """Of every verdict: what differs and by how much, what cannot be told apart, what nothing explains."""
    nominal = "the arm as it was" if diagnosis.context.reference else "the simulator"
    found = [f for f in diagnosis.findings if f.is_chosen]
    if diagnosis.verdict == "no_gap":
        said = "The arm moves as it did" if diagnosis.context.reference else "The arm moves as the simulator does"
        return f"{said}: no difference was found that repeats."
    parts = []
    if diagnosis.verdict == "unexplained":
        parts.append(_unexplained(diagnosis, nominal))
    if found:
        said = "; ".join(_said(f, nominal) for f in found)
        said = said.replace("(", "(95 %: ", 1)  # the other brackets are the same
        opening = {"unexplained": "What was found beside that: ", "ambiguous": "Probably "}.get(diagnosis.verdict, "")
        parts.append(f"{opening}{said}.")
        parts.append(_removed(diagnosis, len(found)))
    parts += [_doubt(f) for f in found if diagnosis.verdict == "ambiguous" and f.is_open]
    return " ".join(part[0].upper() + part[1:] for part in parts)


def _said(finding: Finding, nominal: str) -> str:
    values = {name: Value(e.value, e.low, e.high) for name, e in finding.parameters.items()}
    return say(RECORDS[finding.effect.id], finding.component, values, nominal)


def _removed(diagnosis: Diagnosis, count: int) -> str:
    share, low, high = (round(100 * share) for share in (diagnosis.gap.shrink, *diagnosis.gap.shrink_interval))
    what = _COUNT.get(count, f"all {count}")
    return f"Adding {what} removes {share} % of the gap (95 %: {low} to {high})."


def _doubt(finding: Finding) -> str:
    """Why a finding is not sure."""
    name = f"{_name(finding.effect.id)} at {place(Place.JOINT, finding.component)}"
    if finding.rivals:
        return f"{name} cannot be told from {' or '.join(map(_name, finding.rivals))} by these recordings."
    return f"{name} has a probability of {finding.claimed:.2f} only."


def _unexplained(diagnosis: Diagnosis, nominal: str) -> str:
    joints = [place(Place.JOINT, diagnosis.context.arm.joints[j]) for j in diagnosis.unexplained]
    names = joints[0] if len(joints) == 1 else f"{', '.join(joints[:-1])} and {joints[-1]}"
    verb = "departs" if len(joints) == 1 else "depart"
    return f"{names} {verb} from {nominal} in a way that no known effect explains: look at the joint before you use the patch."


def _name(effect: str) -> str:
    return effect.replace("_", " ")

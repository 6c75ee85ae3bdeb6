"""What stages claim, in one shape: an effect with its size, or several that explain the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim2real.effects import CAMERA_EFFECTS, SCENE_EFFECTS
from sim2real.effects.catalogue import catalogue
from sim2real.effects.sentences import ValueWithInterval, describe_effect
from sim2real.report import camera_sentences as view_words
from sim2real.report import contact_sentences as felt_words
from sim2real.task import noise_effects as findings
from sim2real.task.camera.diagnosis import CameraDiagnosis
from sim2real.task.camera.parameters import EFFECTS
from sim2real.task.contact_force.estimate import ContactForceResult
from sim2real.task.keypoint_noise import KeypointNoise
from sim2real.task.suite.hand_eye_offset import HandEyeOffset
from sim2real.task.suite.image_latency import ImageLatency
from sim2real.task.surface.estimate import SurfaceContactResult

TIMING = ("camera_latency", "clock_offset", "frame_drop", "exposure_blur", "rolling_shutter")
TABLE = "environment"
"""What the catalogue calls the table."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation. name: as the stage calls it; ids: of the catalogue, more than one where nothing ever tells them apart; sizes with
    their intervals, SI units and px; said: half a sentence; parameters: as `patch.yaml` has them, none where no simulator carries it."""

    name: str
    ids: tuple[str, ...]
    sizes: dict[str, ValueWithInterval]
    said: str
    parameters: dict[str, float]

    @property
    def module(self) -> str:
        """Of `together.MODULES`."""
        return module_of(self.ids[0])


@dataclass(frozen=True)
class Finding:
    """Something that is off. stage: that says so; ways: explanations, the most probable first; gain: nats by which what was recorded is more
    probable with it."""

    stage: str
    ways: tuple[Hypothesis, ...]
    gain: float

    @property
    def is_one(self) -> bool:
        """Whether it is one effect of the catalogue."""
        return len({one for way in self.ways for one in way.ids}) == 1


def module_of(effect: str) -> str:
    """The module of the chain that an effect is of."""
    if effect in TIMING:
        return "timing"
    module = catalogue()[effect]["module"]
    return "table" if module == TABLE else module


def camera_findings(view: CameraDiagnosis | None) -> list[Finding]:
    """Of where corners of the resting object are seen."""
    if view is None or view.verdict not in ("identified", "ambiguous"):
        return []
    return [
        Finding("view", tuple(_view_way(e, s) for e, s in ((n.effect, n.sizes), *n.rivals.items())), n.gain)
        for n in view.named
    ]


def _view_way(effect: str, sizes: Mapping[str, ValueWithInterval]) -> Hypothesis:
    known = EFFECTS[effect]
    parameters = dict(zip(known.quantities, (value.value for value in sizes.values())))
    return Hypothesis(effect, tuple(known.ids), dict(sizes), view_words.effect_text(effect, sizes), parameters)


def contact_findings(felt: SurfaceContactResult | ContactForceResult | None, stage: str) -> list[Finding]:
    """Of what the hand felt, by touch or by force."""
    if felt is None or felt.explained is None or felt.verdict == "unexplained":
        return []
    return [
        Finding(stage, tuple(_felt_way(e, s) for e, s in ((n.effect, n.sizes), *n.rivals.items())), n.gain)
        for n in felt.explained.named
    ]


def _felt_way(effect: str, sizes: Mapping[str, ValueWithInterval]) -> Hypothesis:
    parameters = {}
    if effect in SCENE_EFFECTS:
        parameters = {name: value.value for name, value in felt_words.patch_values(effect, sizes).items()}
    return Hypothesis(effect, (effect,), dict(sizes), felt_words.effect_text(effect, sizes), parameters)


def keypoint_noise_findings(scatter: KeypointNoise | None) -> list[Finding]:
    """Of how corners scatter at rest."""
    if scatter is None:
        return []
    found = []
    for effect, values in findings.visible_noise_effects(scatter).items():
        record, first = CAMERA_EFFECTS[effect], next(iter(values.values()))
        way = Hypothesis(
            effect,
            (effect,),
            dict(values),
            describe_effect(record, str(record.target), values, "the simulator"),
            {k: v.value for k, v in values.items()},
        )
        found.append(Finding("scatter", (way,), gaussian_log_bayes_factor(first)))
    return found


def latency_findings(lag: ImageLatency | None) -> list[Finding]:
    """Of images that are late: the camera's latency, or its clock, which one recording cannot tell apart."""
    if lag is None or lag.late is None or lag.verdict == "no_gap":
        return []
    ways = latency_hypotheses(lag.late)
    return [Finding("lag", ways if lag.late.value > 0 else ways[1:], gaussian_log_bayes_factor(lag.late))]


def latency_hypotheses(late: ValueWithInterval) -> tuple[Hypothesis, ...]:
    """What a stream that is late may have: the camera's latency, or its clock."""
    delayed = describe_effect(CAMERA_EFFECTS["camera_latency"], "camera", {"delay": late}, "the simulator")
    return (
        Hypothesis("camera_latency", ("camera_latency",), {"delay": late}, delayed, {"delay": late.value}),
        Hypothesis(
            "clock_offset",
            ("clock_offset",),
            {"offset": late},
            "the camera's clock is off by that",
            {"offset": late.value},
        ),
    )


def hand_eye_offset_findings(meeting: HandEyeOffset | None, turn: np.ndarray | None = None) -> list[Finding]:
    """Of where the hand meets what is seen: a picture that is off, by the camera's place or turn, or by where corners are found. turn: rad (2,),
    where corners at rest say that it is the turn (`astray.turned`)."""
    if meeting is None or meeting.explained is None or meeting.verdict not in ("identified", "ambiguous"):
        return []
    found = []
    for one in meeting.explained.named:
        off = one.sizes
        moved = {axis: -off[axis].value for axis in "xy"}  # a camera that stands elsewhere shows things the other way
        ways = [
            Hypothesis("camera_place", ("camera_extrinsics",), dict(off), "the camera's place", moved),
            Hypothesis("camera_turn", ("camera_extrinsics",), dict(off), "its turn", {}),
            Hypothesis("image_offset", ("keypoint_bias",), {}, "where corners are found", {}),
        ]
        if turn is not None:
            told = dict(zip(("turn_x", "turn_y"), turn.tolist()))
            ways[:2] = replace(ways[1], said="the camera's turn", parameters=told), replace(ways[0], said="its place")
        said = f"the picture shows things {off['x']:mm} and {off['y']:mm} (x, y) from where the hand meets them: by {ways[0].said}"
        found.append(Finding("meeting", (replace(ways[0], said=said), *ways[1:]), one.gain))
    return found


def resolve_conflicts(claims: list[Finding], touch: SurfaceContactResult | None) -> list[Finding]:
    """Claims in the light of one another: the hand feels the table and the camera does not move it. An explanation of the view that has the
    table elsewhere than it was felt is none; one that has it there is the one, and counts once. A camera that the view still names then is the
    gap that the meeting shows, of which the view says more."""
    if touch is not None and touch.explained is not None and touch.verdict not in ("undetermined", "unexplained"):
        claims = _by_touch(claims, touch)
    if any(c.stage == "view" and c.ways[0].module == "camera" for c in claims):
        claims = [c for c in claims if c.stage != "meeting"]
    return claims


def _by_touch(claims: list[Finding], touch: SurfaceContactResult) -> list[Finding]:
    found: list[Finding] = []
    told = {n.effect for n in touch.explained.named if not n.rivals}
    for claim in claims:
        if claim.stage == "view":
            ways = tuple(way for way in claim.ways if not _contradicted(way, touch))
            claim = replace(claim, ways=tuple(way for way in ways if way.name in told) or ways)
        if claim.ways:
            found.append(claim)
    felt = {claim.ways[0].name for claim in found if claim.stage == "touch" and claim.is_one}
    again = [c for c in found if c.stage == "view" and c.is_one and c.ways[0].name in felt]
    return [c for c in found if c not in again]


def _contradicted(way: Hypothesis, touch: SurfaceContactResult) -> bool:
    bounds = {"table_" + name: value for name, value in touch.explained.bounds.items()}
    apart = (
        not (bounds[name].low <= value.high and value.low <= bounds[name].high)
        for name, value in way.sizes.items()
        if name in bounds and name.removeprefix("table_") not in touch.explained.unseen
    )
    return any(apart)


def gaussian_log_bayes_factor(value: ValueWithInterval) -> float:
    """By which a number is more probable than none, were it Gaussian."""
    deviation = max((value.high - value.low) / 3.92, 1e-9)
    return float(np.clip(0.5 * (value.value / deviation) ** 2, 0.0, 1e3))

"""Recordings of one set-up, all stages that they have data for, and the row of each module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.panda import NOMINAL, PandaModel
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.recordings.reading import ContractViolation
from sim2real.task.camera.parameters import EFFECTS, PARAMETERS
from sim2real.task.camera.places import Place
from sim2real.task.camera.view import View, view
from sim2real.task.contact_force.readings import readings
from sim2real.task.contact_force.slide import slides
from sim2real.task.contact_force.stage import Believed, Forces, judge
from sim2real.task.scatter import Scatter, scatter
from sim2real.task.suite.astray import turned
from sim2real.task.suite.covered import without_covered
from sim2real.task.suite.lag import Lag, lag
from sim2real.task.suite.meeting import Meeting, meet
from sim2real.task.suite.near import untouched_track
from sim2real.task.suite.recording import TaskRecording
from sim2real.task.suite.seen import over
from sim2real.task.suite.untouched import Untouched, untouched
from sim2real.task.surface.stage import Felt, feel
from sim2real.task.together import claims as made
from sim2real.task.together.claims import Claim
from sim2real.task.together.elsewhere import Answer
from sim2real.task.track import Track

MODULES = ("camera", "keypoints", "timing", "arm", "contact", "object", "table")
NOT_SEEN = "not seen in this recording"
Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Seen:
    """What recordings of one set-up have: those of the task suite, all tracks of keypoints, and places at which the object rested."""

    tasks: tuple[TaskRecording, ...]
    tracks: tuple[Track, ...]
    places: tuple[Place, ...]


@dataclass(frozen=True, eq=False)
class Row:
    """A module. verdict: identified, ambiguous (effects that explain the same), no_gap, unexplained, or `NOT_SEEN`; claims: what is off;
    share: of all nats that what is off explains, None where nothing is; doubt: why nothing is said, or what nothing explains; said: sentences
    of answers that were given elsewhere."""

    module: str
    verdict: str
    claims: tuple[Claim, ...] = ()
    share: float | None = None
    doubt: str = ""
    said: str = ""


@dataclass(frozen=True, eq=False)
class Whole:
    """The answer: a row each module, and each stage's own, None where there is no data for it. arm: what `diagnose` answered."""

    rows: tuple[Row, ...]
    seen: Seen
    view: View | None = None
    scatter: Scatter | None = None
    touch: Felt | None = None
    force: Forces | None = None
    lag: Lag | None = None
    meeting: Meeting | None = None
    still: Untouched | None = None
    doubts: dict[str, str] = field(default_factory=dict)
    arm: Answer | None = None

    @property
    def verdict(self) -> str:
        """unexplained, identified, ambiguous, no_gap, or undetermined where no module is seen."""
        found = {row.verdict for row in self.rows}
        order = ("unexplained", "ambiguous", "identified", "no_gap")
        return next((verdict for verdict in order if verdict in found), "undetermined")

    def row(self, module: str) -> Row:
        """Of a module."""
        return self.rows[MODULES.index(module)]


def diagnose(
    seen: Seen,
    camera: Camera = CAMERA,
    panda: PandaModel = NOMINAL,
    arm: Answer | None = None,
    tell: Tell = lambda stage: None,
) -> Whole:
    """Every stage that has data. camera: that is believed in; panda: the arm with its own gap; arm: the answer of `diagnose`; tell: hears each stage's name as it begins.

    Of several recordings of the task suite the first is felt by touch, forces are taken together, and delays are those of the first.
    """
    doubts: dict[str, str] = {}
    tasks, tracks = without_covered(seen.tasks, seen.tracks, camera)
    seen = replace(seen, tasks=tasks, tracks=tracks)
    tell("scatter")
    scattered = _tried(doubts, "scatter", lambda: _scattered(seen, camera))
    tell("view")
    viewed = _tried(doubts, "view", lambda: view(seen.places, camera)) if seen.places else None
    if not seen.places:
        doubts["view"] = "the object rests nowhere in the picture"
    touched = forced = late = met = still = None
    if seen.tasks:
        tell("touch")
        touched = _tried(doubts, "touch", lambda: feel(seen.tasks[0], panda))
        lift = touched.lift if touched is not None else 0.0
        felt = over(camera, lift)
        tell("meeting")
        met = _tried(doubts, "meeting", lambda: meet(seen.tasks[0], felt))
        tell("force")
        every = _tried(doubts, "force", lambda: [r for task in seen.tasks for r in readings(task, panda, felt)])
        slid = slides(seen.tasks[0], met, felt) if met is not None else ()
        forced = judge(every, Believed.of(seen.tasks[0].domain), slid) if every is not None else None
        still = _tried(doubts, "untouched", lambda: untouched(seen.tasks[0], felt, lift, scattered))
        tell("lag")
        late = _tried(doubts, "lag", lambda: lag(seen.tasks[0], felt))
    else:
        doubts |= dict.fromkeys(
            ("touch", "force", "meeting", "lag"), "no recording is of the task suite (excite --suite task)"
        )
    for name, stage in (
        ("view", viewed),
        ("touch", touched),
        ("force", forced),
        ("meeting", met),
        ("untouched", still),
        ("lag", late),
    ):
        if stage is not None and stage.doubt:
            doubts[name] = stage.doubt
    claims = made.settled(
        made.of_view(viewed)
        + made.of_scatter(scattered)
        + made.of_felt(touched, "touch")
        + made.of_felt(forced, "force")
        + made.of_meeting(met, _turned(viewed, met, touched))
        + made.of_lag(late),
        touched,
    )
    whole = Whole((), seen, viewed, scattered, touched, forced, late, met, still, doubts, arm)
    total = sum(claim.gain for claim in claims)
    rows = tuple(_row(module, [c for c in claims if c.ways[0].module == module], total, whole) for module in MODULES)
    return replace(whole, rows=rows)


def _turned(viewed: View | None, met: Meeting | None, touched: Felt | None) -> np.ndarray | None:
    """rad (2,) by which the camera is turned, where a picture that is off is so by that; None where it is not, or nobody knows."""
    if met is None or met.explained is None or not met.explained.named or viewed is None or viewed.nominal is None:
        return None
    sizes = met.explained.named[0].sizes
    off = np.array([sizes[axis].value for axis in "xy"])
    return turned(viewed.scene, viewed.nominal.poses, off, touched.lift if touched is not None else 0.0)


def patch(whole: Whole) -> Patch:
    """What is one effect and a simulator carries, within what it takes."""
    entries: dict[str, dict[str, float]] = {}
    for row in whole.rows:
        for claim in row.claims:
            way = claim.ways[0]
            # A late image is late either way, and a picture that is off is off, where it was looked at, by whichever of place and turn.
            is_told = claim.stage in ("lag", "meeting") or claim.is_one
            if row.verdict != "unexplained" and is_told and way.parameters:
                entries.setdefault(way.ids[0], {}).update(way.parameters)
    found = (PatchEffect(effect, "", values) for effect, values in entries.items())
    return Patch(tuple(PatchEffect(e.effect, str(e.record.part), _held(e)) for e in found))


def _held(entry: PatchEffect) -> dict[str, float]:
    """Parameters within the bounds of their quantities."""
    bounds = {q.name: (q.lower, q.upper) for q in entry.record.quantities}
    return {name: float(min(max(value, bounds[name][0]), bounds[name][1])) for name, value in entry.parameters.items()}


def _row(module: str, claims: list[Claim], total: float, whole: Whole) -> Row:
    doubt, stage = _unexplained(module, whole)
    share = sum(c.gain for c in claims) / total if claims and total else None
    if module == "arm" and whole.arm is not None:
        return Row(module, whole.arm.verdict, said=whole.arm.said)
    if stage:
        return Row(module, "unexplained", tuple(claims), share, doubt)
    if claims:
        verdict = "identified" if all(c.is_one for c in claims) else "ambiguous"
        return Row(module, verdict, tuple(claims), share)
    if _is_seen(module, whole):
        return Row(module, "no_gap")
    return Row(module, NOT_SEEN, doubt=_why(module, whole))


def _unexplained(module: str, whole: Whole) -> tuple[str, bool]:
    """Of the module that a stage is first of all about."""
    stages = {
        "camera": (whole.view, whole.meeting, whole.still),
        "table": (whole.touch,),
        "contact": (whole.force,),
    }.get(module, ())
    doubts = [stage.doubt for stage in stages if stage is not None and stage.verdict == "unexplained"]
    return "; ".join(doubts), bool(doubts)


def _is_seen(module: str, whole: Whole) -> bool:
    """Whether a gap of it would have shown."""
    bounds = whole.view.bounds if whole.view and whole.view.verdict in ("no_gap", "identified", "ambiguous") else {}
    clear = {name for name in bounds if name not in whole.view.unseen} if whole.view else set()
    forces = (whole.force.measured or {}) if whole.force else {}
    is_touched = whole.touch is not None and whole.touch.explained is not None
    by_view = {m: any(PARAMETERS[i].name in clear for e in es for i in EFFECTS[e].numbers) for m, es in _VIEWED.items()}
    return {
        "camera": by_view["camera"]
        or (whole.meeting is not None and whole.meeting.verdict not in ("undetermined", "unexplained")),
        "keypoints": whole.scatter is not None,
        "timing": whole.lag is not None and whole.lag.late is not None,
        "arm": False,
        "contact": "table" in forces,
        "object": "mass" in forces or by_view["object"],
        "table": is_touched or by_view["table"],
    }[module]


_VIEWED = {
    "camera": ("camera_place", "camera_turn", "focal_length"),
    "object": ("object_size",),
    "table": ("table_height",),
}


def _why(module: str, whole: Whole) -> str:
    stage = {
        "camera": "view",
        "keypoints": "scatter",
        "timing": "lag",
        "contact": "force",
        "object": "force",
        "table": "touch",
    }
    if module == "arm":
        return "the arm is asked by `diagnose`, of a suite of its own; --arm takes its answer"
    return whole.doubts.get(stage[module], "the recording narrows none of its numbers")


def _scattered(seen: Seen, camera: Camera) -> Scatter | None:
    """Of the longest track; of one of the task suite, while the hand is not at the object: what it presses may rock, and seem to rest."""
    if not seen.tracks:
        return None
    longest = max(seen.tracks, key=lambda track: len(track.time))
    own = next((task for task in seen.tasks if task.track.name == longest.name), None)
    return scatter(untouched_track(own, camera) if own else longest)


def _tried(doubts: dict[str, str], stage: str, ask: Callable):
    """A stage's answer; None where its recording has too little for it, which is kept in words."""
    try:
        return ask()
    except ContractViolation as violation:
        doubts[stage] = str(violation)
        return None

"""A case of the chain's blind set made, asked and judged."""

from __future__ import annotations

import time

import numpy as np

from np_blind.task_cases import Case, Detector
from np_blind.task_reality import Reality
from np_description.camera import CAMERA
from np_description.domains import BUMP
from np_diagnosis.chain.force.stage import Believed
from np_diagnosis.chain.together.claims import module_of
from np_diagnosis.chain.together.whole import Seen, Whole, diagnose
from np_diagnosis.chain.view_stage.places import places

NOISE, GROSS = 0.15, 0.01  # px and share, of the detector
MODULES = {"cable": "contact", "knocked": "camera"}


def answer(case: Case, seed: int) -> dict:
    """A case made, asked and judged."""
    from np_physx_bridge.engine import PhysxEngine  # where SAPIEN is

    class Pulled(PhysxEngine):
        """PhysX with a cable on the object."""

        def step(self, torque, extra, opening) -> None:
            """As in Engine."""
            if pull := case.gap.get("pull"):
                way = case.gap["way"]
                force = pull * np.array([np.cos(way), np.sin(way), 0.0])
                self.object.add_force_at_point(force, self.object.entity.pose.p)
            super().step(torque, extra, opening)

    begun = time.perf_counter()
    finding = Detector(seed * 1000 + case.number, NOISE, GROSS, case.gap.get("turn", 0.0), CAMERA.fx)
    recording = Reality(BUMP, case.patch, seed * 1000 + case.number, Pulled, finding).run()
    made = time.perf_counter()
    rests = tuple(place for place, _ in places(recording.track, recording.domain))
    found = diagnose(Seen((recording,), (recording.track,), rests))
    done = time.perf_counter()
    return {**judged(case, found), "made_s": made - begun, "asked_s": done - made}


def judged(case: Case, found: Whole) -> dict:
    """What is right about an answer."""
    claims = [claim for row in found.rows for claim in row.claims]
    named = [sorted({one for way in claim.ways for one in way.ids}) for claim in claims]
    modules = sorted({row.module for row in found.rows if row.claims or row.verdict == "unexplained"})
    true = MODULES.get(case.kind) or (module_of(case.kind) if case.is_known else None)
    return {
        "case": case.number,
        "kind": case.kind,
        "gap": case.gap,
        "verdict": found.verdict,
        "rows": {row.module: row.verdict for row in found.rows},
        "named": named,
        "said": [" or ".join(way.said for way in claim.ways) for claim in claims],
        "doubts": found.doubts,
        "module": modules == [true] if case.is_known else None,
        "effect": sum(case.kind in ids for ids in named) == 1 if case.is_known else None,
        "wrong": sum(case.kind not in ids for ids in named),
        "unexplained": found.verdict == "unexplained",
        "intervals": _intervals(case, found),
    }


def _intervals(case: Case, found: Whole) -> dict[str, dict]:
    """Every number that was measured beside the truth, its background included."""
    patch, believed = case.patch, Believed.of(BUMP)
    change = patch.scene_change()
    truths = {
        "table": believed.table * change.table,
        "finger": believed.finger * change.finger,
        "mass": believed.mass * change.mass,
    }
    told = {}
    if found.force and found.force.measured:
        told |= {name: (truths[name], *values) for name, values in found.force.measured.items()}
    if found.touch and found.touch.explained and "height" in found.touch.explained.bounds:
        value = found.touch.explained.bounds["height"]
        told["height"] = (change.lift, value.value, value.low, value.high)
    if found.lag and found.lag.late:
        late = sum(e.get("delay") for e in patch.of("camera_latency"))
        told["late"] = (late, found.lag.late.value, found.lag.late.low, found.lag.late.high)
    if found.force and found.force.least_finger is not None:
        told["least_finger"] = (truths["finger"], found.force.least_finger, found.force.least_finger, np.inf)
    return {
        name: {
            "true": true,
            "value": value,
            "low": low,
            "high": high if np.isfinite(high) else None,
            "holds": bool(low <= true <= high),
        }
        for name, (true, value, low, high) in told.items()
    }

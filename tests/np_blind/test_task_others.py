"""Baselines of the chain's set: what each is asked, what it may name, and how it is judged."""

import json
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from sim2real.effects.patch import Patch
from sim2real.simulation.closed_loop import stretches

from np_blind.baselines.identification import Fit
from np_blind.chain import others as task_others
from np_blind.chain.baselines import cma as task_cma
from np_blind.chain.baselines import paper as task_paper
from np_blind.chain.baselines import residual as task_residual
from np_blind.chain.baselines.residual import Course, learn, moved
from np_blind.chain.reality import Reality
from np_control.safety import LIMITS
from np_description.camera import CAMERA
from np_description.domains import BUMP, Pose
from np_description.keypoints import box_keypoints
from np_description.mujoco_engine import MujocoEngine
from np_description.panda import JOINT_NAMES, NOMINAL
from np_description.phases import EXCITE, PhaseState


@pytest.fixture(scope="module")
def recording():
    return Reality(BUMP, Patch(), 3, MujocoEngine).run(("view",))


def test_cma_names_what_is_beyond_limits_and_stays_within_what_is_searched():
    x = [0.0, 2.0, 0.1, 1.0, 0.0, 9.0, -0.5]
    assert task_cma.named(x) == ["camera_extrinsics", "camera_latency", "object_mass", "table_height"]
    given = {one.effect: dict(one.parameters) for one in task_cma.patch_of(x).effects}
    assert given["object_mass"] == {"relative": pytest.approx(0.4)}
    assert given["camera_extrinsics"]["y"] == 0.03 and given["camera_latency"] == {"delay": 0.0}


def row(kind, gap, method, **told):
    return {"kind": kind, "gap": gap, "methods": {method: told}}


def test_a_baseline_is_scored_as_the_doctor_is_and_one_that_names_nothing_is_not_asked_for_names():
    motion = {"windows": 9, "believed": 2.0, "after": 1.5, "truth": 1.0}
    mass = {"object_mass": {}}
    rows = [
        row("clean", {}, "cma", named=["table_height"], motion={**motion, "after": 2.2}),
        row("single", mass, "cma", named=["object_mass"], motion=motion),
        row("single", mass, "cma", error="it came apart"),
        {"kind": "single", "gap": mass, "error": "PhysX is not here"},
    ]
    told = {name: one["value"] for name, one in task_others.figures(rows, "cma").items()}
    assert told["right effects, singles"] == told["false alarm, clean"] == 1.0 and told["errors"] == 0.5
    share = "held-out motion: share of what the true effects remove"
    assert told["does harm to held-out motion"] == told[share] == 0.5
    silent = task_others.figures([row("single", mass, "residual", named=None, motion=motion)], "residual")
    assert set(silent) == {"does harm to held-out motion", "errors", share}


def test_beside_a_baseline_stands_what_the_doctor_answered_to_the_case():
    late = row("single", {"camera_latency": {}}, "residual", named=None, motion={})
    motion = {"windows": 9, "believed": 2.0, "patch": 1.2, "truth": 1.0, "at_once": 1.5}
    answer = {"named": [["camera_latency", "clock_offset"]], "at_once": ["object_mass"], "motion": motion}
    rows = [task_others.beside(late, answer)]
    assert list(rows[0]["methods"]) == ["residual", "doctor", "at once"]
    told, at_once = (task_others.figures(rows, method) for method in ("doctor", "at once"))
    assert told["right effects, singles"]["value"] == 1.0 and at_once["right effects, singles"]["value"] == 0.0
    share = "held-out motion: share of what the true effects remove"
    assert told[share]["value"] == pytest.approx(0.8) and at_once[share]["value"] == pytest.approx(0.5)


def test_a_case_is_recorded_once_for_all_baselines_and_one_that_fails_takes_none_with_it(tmp_path, monkeypatch):
    made = []

    @contextmanager
    def threads(jobs, cluster):
        with ThreadPoolExecutor(jobs) as pool:
            yield pool

    def recorded(case, seed, only=()):
        made.append((case.number, seed))
        return case.number

    def told(recording, seed, seconds=None):
        return task_others.Told([], {"of": recording}, lambda fresh: np.array([1.0, np.nan]))

    def fails(recording, seed):
        raise ValueError("nothing moves")

    monkeypatch.setattr("np_blind.chain.judged.recorded", recorded)
    monkeypatch.setattr("sim2real.task.object_motion.stage.errors", lambda recordings, patch: np.array([2.0, 2.0]))
    monkeypatch.setattr(task_others, "workers", threads)
    for method, ask in (("paper", fails), ("residual", told), ("cma", told)):
        monkeypatch.setattr(f"np_blind.chain.baselines.{method}.ask", ask)
    for _ in range(2):
        assert task_others.main(["--cases", "2", "--seed", "1", "--out", str(tmp_path)]) == 0
    _, second = json.loads((tmp_path / "others.json").read_text())["rows"]
    assert re.search('File "benchmark/np_blind/(?s:.*)nothing moves', second["methods"]["paper"]["error"])
    assert second["methods"]["cma"]["found"] == {"of": 1}
    assert second["methods"]["residual"]["motion"] == {"windows": 1, "believed": 2.0, "truth": 2.0, "after": 1.0}
    assert len(made) == 4  # two cases, each with a recording that nobody hears; the second call asks nothing


def test_a_recording_has_what_the_controller_asked_for(recording):
    (whole,) = stretches(recording.log)
    assert whole.period == pytest.approx(LIMITS.period) and len(whole) == len(recording.log.time) - 1
    assert np.abs(whole.target - whole.position).max() < 0.01 and np.abs(whole.feedforward).max() < 0.05


def test_the_paper_hears_only_what_the_hand_does_in_the_air_and_names_joints_beyond_limits(recording, monkeypatch):
    ends = (("transfer", 0.0), ("touch_table_1", 1.2), ("transfer", 1.3), ("view", 1.4))
    log = SimpleNamespace(**vars(recording.log))
    log.phases = tuple((at, PhaseState(EXCITE, experiment=name)) for name, at in ends)
    (air,) = task_paper.in_the_air(SimpleNamespace(log=log))
    assert len(air) == pytest.approx(1.2 / LIMITS.period, abs=2)

    friction = NOMINAL.frictionloss + 0.3 * np.eye(7)[3] + 1e-3
    fit = Fit("paper", {"frictionloss": friction, "damping": NOMINAL.damping, "armature": NOMINAL.armature})
    asked = {}
    monkeypatch.setattr(task_paper, "paper_identification", lambda *_: fit)
    monkeypatch.setattr(task_paper, "errors", lambda fresh, patch, panda: asked.update(panda=panda) or np.ones(2))
    told = task_paper.ask(SimpleNamespace(log=log), 0)
    assert told.named == ["coulomb_friction"] and told.found[f"coulomb_friction {JOINT_NAMES[3]}"] == pytest.approx(
        0.301
    )
    assert told.off([]).shape == (2,) and (asked["panda"].frictionloss == friction).all()


def course(rng, more, noise=0.0):
    """A push in some direction, in which the object goes `more` farther than believed, and turns to the left."""
    n, way = 60, float(rng.uniform(-np.pi, np.pi))
    pace = np.clip(np.linspace(-1, 2, n), 0, 1) * rng.uniform(0.02, 0.06)
    along = np.array([np.cos(way), np.sin(way)])
    plane = np.column_stack([pace[:, None] * along, np.zeros(n)])
    tip = np.column_stack([plane[:, :2] - 0.05 * along, np.full(n, 0.02)])
    away = np.column_stack([more * plane[:, :2], -more * pace]) + noise * rng.standard_normal((n, 3))
    window = SimpleNamespace(experiment=f"push_{rng.integers(1_000_000)}")
    return Course(window, None, [], plane, tip, np.gradient(tip, 1 / 30, axis=0), way, away)


def test_a_residual_learns_what_is_learnable_and_corrects_nothing_where_it_is_not():
    rng = np.random.default_rng(0)
    learned = learn([course(rng, 0.3, 1e-4) for _ in range(10)])
    other = course(rng, 0.3)
    left = learned.led(other) - other.away
    assert np.abs(left).max() < 0.2 * np.abs(other.away).max()
    turns = [course(rng, more) for more in np.linspace(-0.3, 0.3, 10)]  # more or less far, by nothing that is seen
    assert not learn(turns).led(other).any()


def test_where_an_image_has_the_object_is_found_beside_a_corner_that_is_wrong():
    pose, away = Pose(np.array([0.5, -0.1, 0.045]), np.array([1.0, 0, 0, 0])), np.array([0.004, -0.003, 0.05])
    there = moved(pose, away)
    pixels = CAMERA.project(box_keypoints(np.asarray(BUMP.half_size), there.position, there.quaternion))[0]
    pixels[2] += 9.0
    track = SimpleNamespace(pixels=pixels[None], usable=np.ones((1, 8), bool))
    window = SimpleNamespace(recording=SimpleNamespace(track=track, domain=BUMP), images=np.array([0]))
    assert task_residual._away(window, [pose])[0] == pytest.approx(away, abs=2e-3)
    track.usable[0, 3:] = False
    assert np.isnan(task_residual._away(window, [pose])).all()

"""Slow pushes: bad input refused, the limit surface beside friction added up over points, effects named, intervals that hold."""

import json
import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from push_generator import Sensing, World, pushes, support
from sim2real.cli import pushes as command
from sim2real.task.limit_surface import CHANNELS, Pushed, residuals, wrench
from sim2real.task.push_change import what_changed
from sim2real.task.push_fit import identify, registered
from sim2real.task.push_parameters import PARAMETERS, from_vector, to_vector
from sim2real.task.pushing import read_push, windows

REAL = Path(os.environ.get("NP_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))
SENSING = Sensing()
USUAL = World()
FRICTION, TIP = ("table_friction", "object_mass"), ("gripper_friction",)
GAPS = {
    "none": (USUAL, None),
    "half the friction": (replace(USUAL, weight_friction=0.6), FRICTION),
    "twice the friction": (replace(USUAL, weight_friction=2.4), FRICTION),
    "centre": (replace(USUAL, centre=(0.018, 0.0)), ("object_com",)),
    "size": (replace(USUAL, half_side=0.06), ("object_size",)),
    "corners": (replace(USUAL, support="corners"), ("contact_patch", "torsional_friction")),
    "none again": (USUAL, None),
}
SETUPS, REFERENCE, NEW = 3, 6, 3


def seen(worlds, seed):
    """Windows of a push of each world, None where the tip left at once."""
    found = []
    for number, streams in enumerate(pushes(worlds, SENSING, np.random.default_rng(seed))):
        try:
            found.append(windows(read_push(f"push_{number}", *streams, np.eye(3), SENSING.tip_radius)))
        except ValueError:
            found.append(None)
    return found


@pytest.fixture(scope="module")
def streams():
    return pushes([replace(USUAL, waves=0.0)], SENSING, np.random.default_rng(3), level=0.0)[0]


@pytest.fixture(scope="module")
def drawn():
    """Set-ups, and by kind of gap what was answered of each: (draw, kind, answer)."""
    worlds = [USUAL] * (SETUPS * REFERENCE) + [world for world, _ in GAPS.values() for _ in range(SETUPS * NEW)]
    runs = seen(worlds, 11)
    setups = [
        identify([r for r in runs[n * REFERENCE : (n + 1) * REFERENCE] if r is not None], Pushed())
        for n in range(SETUPS)
    ]
    answers, at = [], SETUPS * REFERENCE
    for kind in GAPS:
        for setup in setups:
            answers.append((kind, what_changed(setup, [r for r in runs[at : at + NEW] if r is not None])))
            at += NEW
    return setups, answers


def changed(stream, number, column, value):
    values = stream[number].copy()
    values[20, column] = value
    return (*stream[:number], values, *stream[number + 1 :])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: changed(s, 0, 1, np.nan), "force: expected finite numbers, got .*nan.* in row 20"),
        (lambda s: changed(s, 1, 0, 0.0), "tip: expected stamps that increase, got -.* s before row 20"),
        (lambda s: (s[0][:, :3], *s[1:]), r"force: expected \(10 or more, 4\) numbers, got \(\d+, 3\)"),
        (lambda s: changed(s, 2, 7, 3.0), "expected unit quaternions of the object"),
        (lambda s: (s[0] * [1, 0, 0, 1], *s[1:]), "expected contact, got a force of"),
        (
            lambda s: (*s[:2], s[2] * [1, 0, 0, 0, 1, 1, 0, 0] + [0, 0, 0, 0, 0, 0, 0, 1]),
            "expected an object that moves",
        ),
        (lambda s: (s[0] + [100, 0, 0, 0], *s[1:]), "expected streams of one time, got 0.00 s in common"),
        (lambda s: tuple(v[v[:, 0] > 0.45] for v in s), "expected 0.3 s without contact at the beginning"),
    ],
)
def test_bad_input_is_refused_in_words(streams, spoil, message):
    with pytest.raises(ValueError, match=message):
        windows(read_push("a", *spoil(streams), np.eye(3), SENSING.tip_radius))


def test_a_turn_that_is_none_is_refused(streams):
    with pytest.raises(ValueError, match="expected an orthogonal turn"):
        read_push("a", *streams, np.diag([1.0, 1.0, 2.0]), SENSING.tip_radius)


def test_windows_leave_the_bias_and_the_beginning_out(streams):
    force, tip, pose = streams
    turn = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
    run = windows(read_push("a", force, tip, pose, np.eye(3), SENSING.tip_radius))
    turned = np.column_stack([force[:, 0], force[:, 1:] @ turn])  # a sensor that is mounted otherwise
    other = windows(read_push("a", turned + [0, 5, -3, 1], tip, pose, turn, SENSING.tip_radius))
    np.testing.assert_allclose(run.force, other.force, atol=1e-9)
    assert run.time[0] > 0.7 and np.hypot(*run.velocity.T).min() > 0.02
    np.testing.assert_allclose(np.hypot(*run.force.T), 1.2, rtol=0.2)
    assert abs(residuals(Pushed(friction=1.2, support=0.383), run)[:, CHANNELS.index("touch")]).max() < 1e-3


def test_a_wrench_lies_on_the_limit_surface_and_the_motion_is_normal_to_it():
    rng = np.random.default_rng(0)
    twist = rng.normal(size=(50, 3)) * [0.1, 0.1, 2.0]
    pushed = Pushed(friction=2.0, support=0.5, half_side=0.04)
    force, moment = wrench(pushed, twist[:, :2], twist[:, 2], np.ones(50))
    radius = 0.5 * 0.08
    np.testing.assert_allclose((force**2).sum(1) / 4 + (moment / (2 * radius)) ** 2, 1)
    normal = np.column_stack([force / 4, moment / (2 * radius) ** 2])
    np.testing.assert_allclose(np.cross(normal, twist), 0, atol=1e-9)


@pytest.mark.parametrize(("kind", "ratio", "most"), [("patch", 0.383, 0.12), ("corners", 0.707, 0.16)])
def test_the_ellipsoid_is_near_friction_added_up_over_points(kind, ratio, most):
    rng = np.random.default_rng(1)
    points, weight = support(World(support=kind))
    twist = rng.normal(size=(300, 3)) * [0.05, 0.05, 1.5]
    velocity = twist[:, None, :2] + twist[:, None, 2:] * np.stack([-points[:, 1], points[:, 0]], axis=-1)
    each = weight[:, None] * velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    true = np.column_stack([each.sum(1), (points[:, 0] * each[..., 1] - points[:, 1] * each[..., 0]).sum(1) / 0.05])
    force, moment = wrench(Pushed(friction=1.2, support=ratio), twist[:, :2], twist[:, 2], np.ones(300))
    off = np.linalg.norm(np.column_stack([force, moment / 0.05]) - true, axis=1) / np.linalg.norm(true, axis=1)
    assert np.median(off) < most < 3 * np.median(off)


def test_a_vector_and_its_numbers_are_the_same():
    pushed = Pushed(friction=3.0, centre=(0.01, -0.02), place=(1.0, 2.0), bias=(0.1, 0.2))
    assert to_vector(from_vector(to_vector(pushed))) == pytest.approx(to_vector(pushed))
    assert len(to_vector(pushed)) == len(PARAMETERS)


def test_a_set_up_is_identified(drawn):
    for setup in drawn[0]:
        known = setup.pushed
        assert known.friction == pytest.approx(1.2, rel=0.15)
        assert known.support == pytest.approx(0.383, rel=0.2)
        assert known.tip_friction == pytest.approx(0.3, rel=0.25)
        assert known.half_side == pytest.approx(0.05, abs=0.003)
        assert known.centre == pytest.approx((0, 0), abs=0.005)


def test_nothing_is_named_where_nothing_changed(drawn):
    assert [answer.verdict for kind, answer in drawn[1] if GAPS[kind][1] is None] == ["no_gap"] * 2 * SETUPS


def test_friction_is_named_as_its_class_and_its_factor_is_held(drawn):
    for kind, factor in (("half the friction", 0.5), ("twice the friction", 2.0)):
        for answer in (answer for k, answer in drawn[1] if k == kind):
            first = answer.named[0]
            assert first.effect == FRICTION and "mu g" in first.split_by
            (size,) = first.sizes
            assert size.is_factor and size.low < factor < size.high and size.high / size.low < 2


def test_what_is_named_is_the_truth_or_said_to_be_a_rival(drawn):
    asked = [(GAPS[kind][1], answer) for kind, answer in drawn[1] if GAPS[kind][1] is not None]
    found = Counter()
    for truth, answer in asked:
        names = {one.effect for one in answer.named}
        rivals = {rival for one in answer.named for rival in one.rivals}
        found["right" if truth in names else "rival" if truth in rivals else "wrong" if names else "silent"] += 1
    assert found["right"] >= 9 and found["wrong"] <= 1


def test_what_no_effect_explains_is_unexplained(drawn):
    cos, sin = np.cos(0.5), np.sin(0.5)
    wrong = np.array([[cos, sin], [-sin, cos]])  # a sensor that has been turned in its mount by 29 degrees
    runs = [replace(run, force=run.force @ wrong) for run in seen([USUAL] * NEW, 6)]
    assert what_changed(drawn[0][0], runs).verdict == "unexplained"


def test_frames_never_brought_together_are_registered():
    runs = [run for run in seen([USUAL] * 8, 5) if run is not None]
    moved = [replace(run, tip=run.tip + [0.4, -0.02]) for run in runs]
    assert registered(moved, Pushed()).registration == pytest.approx((-0.4, 0.02), abs=0.003)


def test_a_set_up_and_a_comparison_need_pushes(drawn):
    with pytest.raises(ValueError, match="expected 3 or more pushes to identify a set-up, got 0"):
        identify([], Pushed())
    with pytest.raises(ValueError, match="expected new pushes to compare, got none"):
        what_changed(drawn[0][0], [])


def test_the_command_answers_in_json(tmp_path, capsys):
    worlds = [USUAL] * 4 + [replace(USUAL, weight_friction=4.0)]
    arrays = {}
    for n, streams in enumerate(pushes(worlds, SENSING, np.random.default_rng(2), duration=1.8)):
        for stream, values in zip(("ft", "tip", "object"), streams):
            arrays[f"{'new' if n == 4 else 'old'}_{n}/{stream}"] = np.column_stack([values[:, 0], values])
    np.savez(tmp_path / "pushes.npz", **arrays)
    words = [str(tmp_path / "pushes.npz"), "--tip-radius", "0.004", "--reference", "old_*", "--new"]
    assert command.main([*words, "new_*", "--out", str(tmp_path / "out.json")]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found == json.loads((tmp_path / "out.json").read_text())
    assert found["figures"]["reference"] == 4 and found["figures"]["named"] == {"/".join(FRICTION): 1}
    assert str(tmp_path) not in found["command"]
    for names, message in (("none", "expected pushes none, got"), ("old_1", "expected other new pushes")):
        assert command.main([*words, names]) == 2
        assert message in json.loads(capsys.readouterr().out.splitlines()[-1])["error"]


@pytest.mark.skipif(
    not (REAL / "mit_push").is_dir(), reason="the pushes are not in the repository: they have no licence"
)
def test_steel_after_aluminium_is_friction_or_mass(capsys):
    file = REAL / "mit_push" / "push_aluminium_steel.npz"
    words = [str(file), "--reference", "Al_*", "--new", "St_*", "--force=-y,-x,z", "--register"]
    assert command.main([*words, "--tip-radius", ".00313", ".004745"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["figures"]["named"]["/".join(FRICTION)] >= 9 and found["figures"]["false_alarms"] == 0
    (size,) = found["new_together"]["named"][0]["sizes"]
    assert size["field"] == "friction" and size["low"] < 2.1 < size["high"]

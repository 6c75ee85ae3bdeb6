"""Friction and mass from the forces and slides of the task suite: what is named, what is left open, and whether intervals hold."""

from dataclasses import replace

import numpy as np
import pytest
from sim2real.task.contact_force.estimate import estimate_friction_and_mass, tip_hops
from sim2real.task.contact_force.fit import NominalContact
from sim2real.task.contact_force.readings import ForceReading
from sim2real.task.contact_force.tap_slide import TapSlide, fit_deceleration
from sim2real.task.hypotheses import MeasuredChanges, compare_hypotheses
from sim2real.task.wrench import ArmMotion, tip_force_covariance, tip_forces
from sim2real.thresholds import THRESHOLDS

from np_control.kinematics import forward_kinematics
from np_description.domains import BUMP
from np_description.panda import NOMINAL

BELIEVED = NominalContact.of(BUMP)
WEIGHT = BELIEVED.mass * 9.81


def test_a_joint_that_rested_in_the_run_up_does_not_feign_a_force():
    """Its friction pushed one way at rest and pushes the other way once it turns."""
    rows, q = 40, np.tile(NOMINAL.ready, (40, 1))
    speed = np.tile([0.05, -0.05, 0.03, 0.05, 0.0, 0.0, 0.05], (rows, 1))
    speed[20:, 4:6] = 0.006
    excess = np.zeros((rows, 7))
    excess[:20, 4:6], excess[20:, 4:6] = -0.1, 0.1
    tip = forward_kinematics(q)[0]
    moved = ArmMotion(np.arange(rows) / 50, q, speed, excess, tip, forward_kinematics(q)[1], 0 * tip)
    free = np.arange(20)
    told = tip_forces(moved, moved.free(free), tip, NOMINAL, moved.turning(free))[20:]
    naive = tip_forces(moved, moved.free(free), tip)[20:]
    assert np.abs(told).max() < 0.4 * np.abs(naive).max()
    wide, narrow = (tip_force_covariance(moved, tip, NOMINAL, known)[20:] for known in (moved.turning(free), None))
    assert np.trace(wide[0]) > 1.5 * np.trace(narrow[0])


def readings(table=1.0, mass=1.0, finger=1.0, kinds=("drag", "push", "scrape"), seed=0):
    rng = np.random.default_rng(seed)
    mu, weight = table * BELIEVED.table, mass * WEIGHT
    made = [("drag", n, mu * (n + weight)) for n in (1.0, 3.0, 5.0, 9.0, 14.0)]
    made += [("push", 0.0, mu * weight)] * 4 + [("scrape", 6.0, finger * 6.0)]
    return [
        ForceReading(f"{kind}_{k}", kind, force + 0.03 * rng.standard_normal(), normal, 0.04 + 0.01 * force)
        for k, (kind, normal, force) in enumerate(made)
        if kind in kinds
    ]


def slips(finger, pressed):
    return [
        ForceReading(f"slip_{k}", "drag", finger * n, n, 0.04, "drags", 0.03, follows=0.03)
        for k, n in enumerate(pressed)
    ]


def pulled(pull, seed=1):
    """Pushes and drags in four directions of an object that something else pulls by (2,) N."""
    ways = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
    return [
        replace(one, force=one.force - float(np.dot(pull, ways[k % 4])), way=ways[k % 4])
        for k, one in enumerate(readings(kinds=("drag", "push"), seed=seed))
    ]


def test_an_object_that_something_pulls_is_unexplained_and_the_pull_is_told():
    assert all(estimate_friction_and_mass(pulled((0.0, 0.0), seed), BELIEVED).verdict == "no_gap" for seed in range(6))
    found = estimate_friction_and_mass(pulled((-0.3, 0.2)), BELIEVED)
    assert found.verdict == "unexplained" and "pulls the object by -0.3" in found.abstention_reason


def test_what_pulls_an_object_down_at_one_place_is_no_mass():
    """A magnet under the table: of readings in a row of places, those over it weigh more."""
    places = [(0.45 + 0.012 * k, -0.15) for k in range(9)]

    def pulled_down(most, seed):
        made = readings(kinds=("drag", "push"), seed=seed)
        return [
            replace(one, place=place, force=one.force + BELIEVED.table * most * k / 8)
            for k, (one, place) in enumerate(zip(made, places))
        ]

    assert all(estimate_friction_and_mass(pulled_down(0.0, seed), BELIEVED).verdict == "no_gap" for seed in range(6))
    found = estimate_friction_and_mass(pulled_down(1.5, 1), BELIEVED)
    assert found.verdict == "unexplained" and "more at one place than at another" in found.abstention_reason


def tapped(slowed, seed):
    """Two taps whose tip stops within 40 ms, and an object that friction slows by `slowed` m/s^2."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 0.15, 0.002)
    speed = 0.35 * np.clip((0.1 - time) / 0.04, 0.0, 1.0)
    way = np.cumsum(speed) * 0.002
    reached = -TapSlide("", way, speed, 0.0).short(slowed)
    return [TapSlide(f"tap_{k}", way, speed, -reached + 5e-4 * rng.standard_normal()) for k in (1, 2)]


@pytest.mark.parametrize("seed", range(3))
def test_a_heavier_object_slides_as_far_and_one_that_is_pulled_down_does_not(seed):
    by_weight = BELIEVED.table * 9.81
    heavier = estimate_friction_and_mass(readings(mass=1.7), BELIEVED, tapped(by_weight, seed))
    assert heavier.verdict == "identified" and [one.hypotheses[0].name for one in heavier.comparison.findings] == [
        "object_mass"
    ]
    assert fit_deceleration(tapped(by_weight, seed)) == pytest.approx(by_weight, rel=0.1)
    held = estimate_friction_and_mass(readings(mass=1.7), BELIEVED, tapped(1.7 * by_weight, seed))
    assert held.verdict == "unexplained" and "are no weight" in held.abstention_reason
    assert (
        estimate_friction_and_mass(readings(mass=1.7), BELIEVED, tapped(1.7 * by_weight, seed)[:1]).verdict
        == "identified"
    )


@pytest.mark.parametrize(
    ("change", "effect"),
    [({"table": 1.4}, "table_friction"), ({"mass": 1.5}, "object_mass")],
)
def test_forces_name_what_changed_and_predict_what_was_left_out(change, effect):
    found = estimate_friction_and_mass(readings(**change), BELIEVED)
    assert found.verdict == "identified" and [one.hypotheses[0].name for one in found.comparison.findings] == [effect]
    (size,) = found.comparison.findings[0].hypotheses[0].estimates.values()
    assert size.low <= np.log(*change.values()) <= size.high
    assert found.after < 0.5 * found.before


def test_nothing_is_named_where_nothing_changed():
    verdicts = [estimate_friction_and_mass(readings(seed=seed), BELIEVED).verdict for seed in range(20)]
    assert verdicts.count("no_gap") >= 19


def test_pushes_alone_hold_friction_and_mass_as_one():
    found = estimate_friction_and_mass(readings(mass=1.6, kinds=("push",)), BELIEVED)
    assert found.verdict == "ambiguous"
    (one,) = found.comparison.findings
    assert {way.name for way in one.hypotheses} == {"table_friction", "object_mass"}


def test_too_few_readings_say_nothing():
    assert estimate_friction_and_mass(readings()[:2], BELIEVED).verdict == "undetermined"


def test_what_is_not_measured_is_unseen():
    spread = np.array(THRESHOLDS.surface_contact.height)
    measured = MeasuredChanges(("a",), np.zeros(1), np.eye(1), spread[:1], spread[1:], {"x": ("a",)})
    found = compare_hypotheses(measured)
    assert found.verdict == "undetermined" and found.unidentifiable == ("a",)


@pytest.mark.parametrize("finger", [0.4, 0.6])
def test_strokes_that_slip_in_one_proportion_are_the_fingertips(finger):
    found = estimate_friction_and_mass(readings() + slips(finger, (1.2, 4.3)), BELIEVED)
    assert found.verdict == "identified" and [one.hypotheses[0].name for one in found.comparison.findings] == [
        "gripper_friction"
    ]
    value, low, high = found.measured["finger"]
    assert low <= finger <= high and high - low < 0.3 * finger


def test_a_weak_stroke_is_not_asked_to_agree_better_than_it_can():
    strong = slips(0.48, (3.2, 5.1, 6.3))
    weak = [replace(one, force=0.56 * one.normal, deviation=0.05) for one in slips(0.48, (1.1,))]
    found = estimate_friction_and_mass(readings() + strong + weak, BELIEVED)
    assert [one.hypotheses[0].name for one in found.comparison.findings] == ["gripper_friction"]
    sure = [replace(one, force=0.62 * one.normal) for one in slips(0.48, (8.0,))]
    assert "finger" not in estimate_friction_and_mass(readings() + strong + sure, BELIEVED).measured


def test_strokes_that_hop_or_one_that_slips_say_no_fingertip():
    hopped = [replace(one, force=ratio * one.normal) for one, ratio in zip(slips(1.0, (1.2, 4.3)), (0.8, 0.5))]
    for seen in (hopped, slips(0.5, (4.3,))):
        found = estimate_friction_and_mass(readings() + seen, BELIEVED)
        assert (
            found.verdict == "no_gap" and "finger" not in found.measured and "finger" in found.comparison.unidentifiable
        )


def test_an_object_that_lags_and_a_face_that_is_held_down_do_not_feign_a_mass():
    held = [replace(r, normal=0.4, force=BELIEVED.table * (0.4 + WEIGHT)) for r in readings() if r.kind == "push"]
    lags = [replace(r, follows=0.5, force=0.7 * r.force) for r in readings() if r.kind == "drag" and r.normal < 4]
    strong = [r for r in readings() if r.kind == "drag" and r.normal > 4]
    assert estimate_friction_and_mass(held + lags + strong, BELIEVED).verdict == "no_gap"


@pytest.mark.slow
def test_intervals_hold_where_forces_share_errors():
    """Drags and pushes each way are off by .02 N in common, and a slow slide takes what its coefficient says within 2.6 %."""
    rng, held = np.random.default_rng(8), {"table": 0, "mass": 0}
    for seed in range(60):
        table, mass = np.exp(rng.uniform(-0.4, 0.4, 2))
        law, shared = rng.uniform(0.974, 1.026), rng.normal(0.0, 0.02, 3)
        made = readings(table * law, mass, seed=seed, kinds=("drag", "push"))
        groups = [0 if r.kind == "drag" else 1 + k % 2 for k, r in enumerate(made)]
        made = [replace(r, group=str(g), force=r.force + shared[g]) for r, g in zip(made, groups)]
        found = estimate_friction_and_mass(made, BELIEVED).measured
        for name, true in (("table", table * BELIEVED.table), ("mass", mass * BELIEVED.mass)):
            held[name] += found[name][1] <= true <= found[name][2]
    assert min(held.values()) >= 54


def test_strokes_that_a_tip_of_their_proportion_would_have_led_say_that_it_hops():
    """As MuJoCo's rough tip does: two weak strokes of one proportion, and stronger ones that go along too little."""
    weak = [replace(one, follows=0.2) for one in slips(0.62, (1.0, 1.6))]
    strong = [replace(one, force=0.5 * one.normal, follows=0.7) for one in slips(0.62, (3.7, 5.5))]
    weight = BELIEVED.mass * 9.81
    led = [replace(one, force=BELIEVED.table * (one.normal + weight), follows=0.95) for one in strong]
    hopped, true = (estimate_friction_and_mass(readings() + weak + more, BELIEVED) for more in (strong, led))
    assert "finger" not in hopped.measured and not [
        n for n in hopped.comparison.findings if n.hypotheses[0].name == "gripper_friction"
    ]
    assert true.measured["finger"][0] == pytest.approx(0.62, rel=0.05)


def test_a_tip_that_leads_the_object_nowhere_slips_whatever_pushes_say_of_the_table():
    """Without a drag that leads the object, table and mass are one product, here .32 and 183 g for .39 and 144 g: such a tip would lead it."""
    nowhere = slips(0.42, (1.3, 1.9, 3.4, 5.2, 9.8, 16.8))
    partly = [replace(one, follows=0.5) for one in nowhere]
    assert tip_hops(partly, 0.42, 0.32, 0.183) and not tip_hops(nowhere, 0.42, 0.32, 0.183)


def test_a_scrape_says_what_the_fingertip_holds_at_least():
    found = estimate_friction_and_mass(readings(finger=0.7, kinds=("push", "scrape")), BELIEVED)
    assert found.verdict == "no_gap" and 0.6 < found.least_finger < 0.72

"""Effects in words: every record's phrase, numbers with their intervals, and the sentence of each verdict."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.effect import Effect, EffectTarget, Quantity
from sim2real.effects.joint_dynamics.friction_curve import SPEEDS, WAYS, value_name
from sim2real.effects.sentences import ValueWithInterval, describe_effect, template_fields
from sim2real.report.next_steps import suggest_next_steps
from sim2real.report.plots import friction_plot
from sim2real.report.sentence import sentence

from np_description.panda import NOMINAL

SIMULATOR = "the simulator"


@pytest.mark.parametrize("record", ARM_EFFECTS.values(), ids=lambda record: record.id)
def test_every_effect_of_ours_has_a_phrase_of_its_own_quantities(record):
    assert template_fields(record.sentence_template) <= {q.name for q in record.quantities} | {"at", "nominal"}
    assert template_fields(record.sentence_template) & {q.name for q in record.quantities}
    component = "arm" if record.target is EffectTarget.ARM else "panda_joint3"
    words = describe_effect(
        record, component, {q.name: ValueWithInterval(0.2, 0.19, 0.21) for q in record.quantities}, SIMULATOR
    )
    assert "{" not in words and "_" not in words and not words.endswith(".")
    assert (
        record.target is EffectTarget.ARM or f"{'link' if record.target is EffectTarget.LINK else 'joint'} 3" in words
    )


@pytest.mark.parametrize(
    "value, spec, text",
    [
        (ValueWithInterval(0.34997, 0.345, 0.355), "kg", "0.350 kg (0.345 to 0.355)"),
        (ValueWithInterval(0.8, 0.788, 0.812), "Nm more/less", "0.80 Nm (0.79 to 0.81) more"),
        (ValueWithInterval(-0.8, -0.812, -0.788), "Nm more/less", "0.80 Nm (0.79 to 0.81) less"),
        (ValueWithInterval(-0.01, -0.05, 0.03), "Nm more/less", "0.01 Nm (-0.03 to 0.05) less"),
        (ValueWithInterval(0.02, 0.018, 0.022), "% too_strong/too_weak", "2.0 % (1.8 to 2.2) too strong"),
        (ValueWithInterval(0.004, 0.0035, 0.0045), "ms", "4.0 ms (3.5 to 4.5)"),
        (ValueWithInterval(1200.0, 1150.0, 1250.0), "Nm/s", "1200 Nm/s (1150 to 1250)"),
        (ValueWithInterval(0.0, 0.0, 0.0), "kg_m", "0 kg m (0 to 0)"),
    ],
)
def test_a_number_has_the_digits_of_its_interval(value, spec, text):
    assert format(value, spec) == text


def test_an_effect_without_a_phrase_says_its_name_and_numbers():
    own = Effect("steady_pull", EffectTarget.ARM, (Quantity("force_x", "N", -9, 9),), lambda context: [])
    assert (
        describe_effect(own, "arm", {"force_x": ValueWithInterval(3.0, 2.9, 3.1)}, SIMULATOR)
        == "the arm has steady pull: force x 3.0 N (2.9 to 3.1)"
    )


def finding(effect, component, values, competing=(), probability=1.0):
    return SimpleNamespace(
        effect=SimpleNamespace(id=effect),
        component=component,
        parameters={name: ValueWithInterval(*numbers) for name, numbers in values.items()},
        is_chosen=True,
        competing_effects=competing,
        class_probability=probability,
        is_open=bool(competing) or probability < 0.9,
        is_shown_to_help=True,
    )


PAYLOAD = finding("payload", "arm", {"mass": (0.35, 0.345, 0.355)})
FRICTION = finding("coulomb_friction", "panda_joint4", {"level": (0.8, 0.788, 0.812)})


def diagnosis(verdict, findings=(), unexplained=(), reference=0):
    return SimpleNamespace(
        verdict=verdict,
        findings=findings,
        unexplained=unexplained,
        gap=SimpleNamespace(shrink=0.968, shrink_interval=(0.96, 0.975)),
        context=SimpleNamespace(reference=reference, arm=SimpleNamespace(joints=NOMINAL.joints)),
    )


def sentence_of(*args, **named):
    one = diagnosis(*args, **named)
    left = {NOMINAL.joints[j]: 0.041 for j in one.unexplained}
    return sentence(one.verdict, one.findings, left, one.gap, bool(one.context.reference))


def test_what_is_identified_is_said_with_what_it_removes():
    assert sentence_of("identified", (PAYLOAD, FRICTION)) == (
        "The arm carries 0.350 kg (95 %: 0.345 to 0.355) that the simulator does not have; "
        "joint 4 has 0.80 Nm (0.79 to 0.81) more dry friction. Adding both removes 97 % of the gap (95 %: 96 to 98)."
    )


def test_many_friction_curves_are_one_clause_with_one_number_a_joint():
    def curve(joint, most):
        return finding(
            "friction_curve",
            f"panda_joint{joint}",
            {"positive_30": (0.9, -1, 3), "negative_300": (most, most, most)},
        )

    some = tuple(curve(joint, most) for joint, most in ((4, -0.28), (1, 0.262), (5, 0.19)))
    assert sentence_of("identified", (some[0], PAYLOAD, *some[1:])) == (
        "3 joints have other friction curves: they differ by up to 0.28 Nm at joint 4, 0.26 Nm at joint 1 and 0.19 Nm at joint 5; "
        "the arm carries 0.350 kg (95 %: 0.345 to 0.355) that the simulator does not have. "
        "Adding all 4 removes 97 % of the gap (95 %: 96 to 98)."
    )
    assert sentence_of("identified", some[:2]).count("has another friction curve: forwards") == 2


def test_of_many_effects_three_are_named_and_the_others_counted():
    joints = [
        finding("coulomb_friction", f"panda_joint{n}", {"level": (n / 10, n / 10, n / 10)}, ("stribeck_friction",))
        for n in range(1, 8)
    ]
    said = sentence_of("identified", joints)
    assert said.split(". ")[0].endswith(
        "joint 3 has 0.300 Nm (0.300 to 0.300) more dry friction; and 4 more, see the report's table"
    )
    assert "joint 4" not in said and said.endswith("Adding all 7 removes 97 % of the gap (95 %: 96 to 98).")
    assert "see the report" not in sentence_of("identified", joints[:3]) and "and 1 more" in sentence_of(
        "identified", joints[:4]
    )
    open_ = sentence_of("ambiguous", joints)
    assert open_.count("cannot be distinguished") == 3 and open_.endswith("4 more are not sure either.")
    partly = sentence_of("partly_explained", joints, (6,))
    assert partly.startswith("The difference is partly explained: 7 effects are shown") and "; and 4 more" in partly
    curves = [finding("friction_curve", f"panda_joint{n}", {"positive_30": (0.9, 0.8, 1)}) for n in range(1, 5)]
    assert "; and 4 more" in sentence_of("identified", (*joints[:3], *curves))
    assert "4 joints have" in (said := sentence_of("identified", (*curves, *joints))) and "; and 5 more" in said


def test_the_page_draws_friction_only_of_joints_with_a_curve_of_their_own():
    names = [value_name(way, speed) for way in WAYS for speed in SPEEDS]
    curve = finding("friction_curve", "panda_joint4", dict.fromkeys(names, (0.1, 0.0, 0.2)))
    one = SimpleNamespace(context=SimpleNamespace(reference=0, arm=NOMINAL))
    drawn = friction_plot(one, (FRICTION, curve))
    assert "panda_joint4" in drawn and "panda_joint3" not in drawn
    assert friction_plot(one, (FRICTION,)) == ""
    assert "friction (Nm)" in drawn and "change of friction" not in drawn
    one.context.reference = 1
    assert "change of friction (Nm)" in friction_plot(one, (curve,))


def test_without_a_gap_nothing_is_claimed():
    assert sentence_of("no_gap") == "The arm moves as the simulator does: no difference was found that repeats."
    assert sentence_of("no_gap", reference=1).startswith("The arm moves as it did: ")


def test_what_is_ambiguous_says_between_what():
    open_ = finding("torque_scale", "panda_joint2", {"scale": (-0.1, -0.11, -0.09)}, ("payload", "link_com"))
    said = sentence_of("ambiguous", (open_, PAYLOAD))
    assert said.startswith("Probably the drive of joint 2 gives 10 % (95 %: 9 to 11) less torque than commanded; ")
    assert said.endswith(
        "Torque scale at joint 2 cannot be distinguished from payload or link com by these recordings."
    )
    unsure = finding("coulomb_friction", "panda_joint4", {"level": (0.8, 0.7, 0.9)}, probability=0.62)
    assert sentence_of("ambiguous", (unsure,)).endswith("has a probability of 0.62 only.")


def test_what_is_unexplained_names_the_joint_first():
    said = sentence_of("unexplained", (FRICTION,), (1, 2))
    assert said.startswith("Joint 2 and joint 3 depart from the simulator in a way that no known effect explains")
    assert "What was found beside that: joint 4 has 0.80 Nm" in said
    assert sentence_of("unexplained", (), (6,)).startswith("Joint 7 departs from")


def test_what_is_partly_explained_says_both_halves_first():
    said = sentence_of("partly_explained", (FRICTION,), (4, 6))
    first = said.split(". ")[0]
    assert "one effect is shown to help" in first and "0.041 Nm at joint 5 and 0.041 Nm at joint 7" in first
    assert "joint 4 has 0.80 Nm" in said


def test_the_loop_goes_on_only_where_there_is_a_patch_to_use():
    folder = Path("runs/report")
    assert suggest_next_steps(diagnosis("no_gap"), folder) == []
    assert suggest_next_steps(diagnosis("identified", (PAYLOAD,), reference=1), folder) == []
    commands = [command for _, command in suggest_next_steps(diagnosis("identified", (PAYLOAD,)), folder)]
    assert "--patch runs/report/patch.yaml" in commands[1] and len(commands) == 8
    judged, released = (
        next(i for i, c in enumerate(commands) if f"np_training.{name} " in c) for name in ("evaluate", "release")
    )
    assert judged + 1 == released and commands[judged].endswith("--out runs/patched/evaluation.jsonl")
    partly = [command for _, command in suggest_next_steps(diagnosis("partly_explained", (PAYLOAD,), (1,)), folder)]
    assert partly == commands
    unexplained = [command for _, command in suggest_next_steps(diagnosis("unexplained", (), (1,)), folder)]
    assert len(unexplained) == 2 and not any("train" in command for command in unexplained)

"""One record an effect: found by its place, in the catalogue, harmless at zero, refused out of its range."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.catalogue import ROW, catalogue, equivalence_classes
from sim2real.effects.effect import ARM, Effect, EffectTarget
from sim2real.effects.gravity import GravityTorque
from sim2real.effects.patch import Patch, PatchEffect, load_patch
from sim2real.effects.registry import MODULES, find_arm_effects

from np_description.panda import NOMINAL

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "effects"
every = pytest.mark.parametrize("record", ARM_EFFECTS.values(), ids=list(ARM_EFFECTS))


def component(record: Effect) -> str:
    return ARM if record.target is EffectTarget.ARM else "panda_joint4"


@every
def test_a_record_is_complete(record):
    assert record.module in MODULES and set(ROW) <= set(record.entry)
    assert len({q.name for q in record.quantities}) == len(record.quantities) > 0
    for q in record.quantities:
        assert q.lower < q.upper and q.lower <= 0 <= q.upper and q.unit
    seen = record.detection_limit
    places = {EffectTarget.ARM: False, EffectTarget.JOINT: True, EffectTarget.LINK: True}
    assert bool(seen.joints) is places[record.target] and seen.largest > 1
    assert np.all(np.array(seen.limit) > 0) and np.size(seen.limit) == (7 if seen.joints else 1)


@every
def test_nothing_of_an_effect_does_nothing(record):
    patch = Patch((PatchEffect(record.id, component(record), {q.name: 0.0 for q in record.quantities}),))
    arm = patch.panda()
    for name in ("frictionloss", "damping", "armature"):
        assert np.array_equal(getattr(arm, name), getattr(NOMINAL, name))
    for name, body in NOMINAL.inertials.items():
        assert np.allclose(arm.inertials[name].com, body.com) and np.allclose(arm.inertials[name].inertia, body.inertia)
    effects, rng = ArmEffects(patch, 0.002), np.random.default_rng(0)
    for _ in range(5):
        q, dq, torque = NOMINAL.ready + 0.1 * rng.normal(size=7), rng.normal(size=7), rng.normal(size=7)
        assert np.allclose(effects.drive(torque, q), torque)
        assert np.allclose(effects.extra(q, dq), 0.0, atol=1e-12)
        for seen, true in zip(effects.sense(q, dq, torque), (q, dq, torque)):
            assert np.allclose(seen, true)


@every
def test_what_is_out_of_range_is_refused_with_the_range(record, tmp_path):
    path, q = tmp_path / "patch.yaml", record.quantities[0]
    entry = {"effect": record.id, "component": component(record), "parameters": {q.name: 1.01 * q.upper + 1.0}}
    path.write_text(yaml.safe_dump({"effects": [entry]}))
    with pytest.raises(ValueError, match=f"entry 0: expected {q.name} of {record.id} from .* to {q.upper:g}"):
        load_patch(path)


@settings(deadline=None, max_examples=40)
@given(st.data())
def test_only_what_a_simulator_can_do_changes_what_it_does(data):
    """`supported_in` is what the hooks say: an effect without any moves nothing, one with some does, at some size."""
    record = data.draw(st.sampled_from(list(ARM_EFFECTS.values())))
    values = {q.name: data.draw(st.floats(0.4, 0.8)) * q.upper for q in record.quantities}
    patch = Patch((PatchEffect(record.id, component(record), values),))
    arm, effects, rng = patch.panda(), ArmEffects(patch, 0.002), np.random.default_rng(1)
    changed = any(
        not np.array_equal(getattr(arm, name), getattr(NOMINAL, name))
        for name in ("frictionloss", "damping", "armature")
    ) or any(
        not np.allclose(arm.inertials[n].com, b.com) or not np.allclose(arm.inertials[n].inertia, b.inertia)
        for n, b in NOMINAL.inertials.items()
    )
    for step in range(200):
        q = NOMINAL.ready + 0.3 * np.sin(0.05 * step + np.arange(7))
        dq, torque = 2.0 * np.cos(0.05 * step + np.arange(7)), 300.0 * rng.normal(size=7)
        sensed = effects.sense(q, dq, torque)
        changed |= not np.allclose(effects.drive(torque, q), torque) or effects.extra(q, dq).any()
        changed |= any(not np.allclose(a, b) for a, b in zip(sensed, (q, dq, torque)))
    assert bool(changed) is record.is_simulated is ("bridge" in record.supported_in)
    assert effects.ignored == (() if record.is_simulated else (record.id,))


def test_a_drive_saturates_with_all_that_it_gives_or_with_the_command_alone():
    hold = GravityTorque()(NOMINAL.ready)
    asked = np.full(7, 30.0)
    for values, share in (({"limit": 40.0}, 1.0), ({"limit": 40.0, "gravity_apart": 1.0}, 0.0)):
        arm = ArmEffects(Patch((PatchEffect("torque_saturation", "panda_joint4", values),)), 0.002)
        given_ = arm.drive(asked, NOMINAL.ready)
        assert given_[3] == pytest.approx(min(30.0, 40.0 - share * hold[3]))
        assert np.allclose(np.delete(given_, 3), 30.0)
    assert hold[3] > 11.0


def test_classes_name_effects_of_the_catalogue():
    for members, split_by in equivalence_classes():
        assert split_by and {part.split(" (")[0] for m in members for part in m.split(" + ")} <= set(catalogue())


def test_an_effect_of_ones_own_is_one_file():
    found = find_arm_effects(str(EXAMPLES))
    assert set(found) - set(ARM_EFFECTS) == {"steady_pull"}
    assert found["steady_pull"].supported_in == ("bridge", "forward", "training")


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("other", "", "expected a sim2real.effects.effect.Effect called EFFECT"),
        (
            "other",
            "from sim2real.effects.timing.packet_loss import EFFECT\n",
            "expected the effect 'other' of joint or link or arm, once; got 'packet_loss'",
        ),
        (
            "packet_loss",
            "from sim2real.effects.timing.packet_loss import EFFECT\n",
            "'packet_loss' of joint or link or arm, once",
        ),
    ],
)
def test_a_file_that_is_no_effect_is_named(tmp_path, name, text, message):
    (tmp_path / f"{name}.py").write_text(text)
    with pytest.raises(ImportError, match=message):
        find_arm_effects(str(tmp_path))


def test_the_former_name_of_an_effect_is_read(tmp_path):
    text = (EXAMPLES / "steady_pull.py").read_text()
    (tmp_path / "steady_pull.py").write_text(text.replace("EFFECT = ", "RECORD = "))
    assert "steady_pull" in find_arm_effects(str(tmp_path))


def test_a_folder_that_is_none_is_named(tmp_path):
    with pytest.raises(ImportError, match="NP_EFFECTS_PATH: expected folders .*missing"):
        find_arm_effects(str(tmp_path / "missing"))

"""A recording is read alike however it is written, or the difference is named in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from bag_variants import JITTER, Variant, write_variant
from bags import record_episode
from rclpy.serialization import serialize_message
from sim2real.recordings.reading import load_log

from np_description.message_arrays import image_array
from np_description.phases import PhaseState
from np_record.bag import Message, Recording
from np_record.recorded_episode import load_episode
from np_record.topics import BY_NAME
from np_ros.messages import gains_message

PHASES = {0: PhaseState("pre"), 50: PhaseState("approach"), 100: PhaseState("post"), 180: PhaseState("succeeded")}
COUNT, PERIOD = 200, 2_000_000
CHANGES = {0: 1.0, 90: 0.5}  # step at which the gains change, share of the stiffest


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Messages of an episode, its run_info, and what each reader makes of it."""
    bag = record_episode(tmp_path_factory.mktemp("original") / "bag", COUNT, PHASES)
    with Recording(bag) as recording:
        messages, run_info = [*recording.messages()], json.dumps(recording.information)
    for step, share in CHANGES.items():
        gains = serialize_message(gains_message(np.stack([100 * share * np.ones(7), np.ones(7)])))
        messages.append(Message(step * PERIOD, BY_NAME["target_gains"], gains))
    messages.sort(key=lambda message: message.stamp)
    plain = Variant("mcap", "none", 1, "header", "same", "same", False, False, False, False)
    return (
        messages,
        run_info,
        read_all(write_variant(tmp_path_factory.mktemp("plain") / "bag", messages, plain, 0, run_info)),
    )


def read_all(path: Path) -> dict:
    """By reader: arrays by name, or the error."""
    return {reader.__name__: _tried(reader, path) for reader in (log, episode, images)}


def _tried(reader, path):
    try:
        return reader(path)
    except ValueError as error:
        return str(error)


def log(path: Path) -> dict:
    found = load_log(path)
    commands = {f"commands.{name}": getattr(found.commands, name) for name in ("rows", "torque", "target", "stiffness")}
    own = {name: getattr(found, name) for name in ("time", "position", "velocity", "torque")}
    return {**own, **commands, "phases": np.array([at for at, _ in found.phases])}


def episode(path: Path) -> dict:
    with Recording(path) as recording:
        found = load_episode(recording)
    series = {
        name: getattr(found, name)
        for name in ("position", "effort", "command", "keypoints", "keypoint_error", "distance")
    }
    arrays = {f"{name}.{part}": getattr(own, part) for name, own in series.items() for part in ("time", "values")}
    outcome = found.outcome
    return {
        **arrays,
        "phases": np.array([at for at, _ in found.phases]),
        "outcome": np.array([outcome.success, outcome.distance, outcome.duration]),
    }


def images(path: Path) -> dict:
    with Recording(path) as recording:
        rows = [*recording.read("camera/image_raw", image_array)]
    return {"stamps": np.array([at for at, _ in rows]), "mean": np.array([pixels.mean() for _, pixels in rows])}


def differences(seed: int, original, folder: Path) -> list[str]:
    """What differs, and is not named."""
    messages, run_info, expected = original
    variant = Variant.draw(seed)
    got = read_all(write_variant(folder / f"bag_{seed}", messages, variant, seed, run_info))
    late = JITTER if variant.clock == "jitter" else 0
    wrong = []
    for reader, answer in got.items():
        if isinstance(answer, str):
            if "\n" in answer or not any(words in answer for words in variant.refusals):
                wrong.append(f"{seed} {variant}: {reader}: {answer}")
            continue
        for name, values in expected[reader].items():
            is_dated_by_log = name in ("phases", "commands.stiffness", "outcome")
            if answer[name].shape != values.shape:
                wrong.append(f"{seed} {variant}: {reader}: {name}: {answer[name].shape}")
            elif late and name == "commands.stiffness":  # at most the row at which the gains change
                if (answer[name] != values).any(axis=1).sum() > len(CHANGES):
                    wrong.append(f"{seed} {variant}: {reader}: {name}")
            elif not np.allclose(answer[name], values, rtol=0, atol=1e-9 + is_dated_by_log * late / 1e9):
                wrong.append(f"{seed} {variant}: {reader}: {name}: {np.abs(answer[name] - values).max()}")
    if variant.clock != "wall" and not isinstance(got["log"], dict):
        wrong.append(f"{seed} {variant}: the arm's joints are there, and were refused: {got['log']}")
    return wrong


@pytest.mark.slow
def test_twenty_variants_are_read_alike(original, tmp_path):
    assert [line for seed in range(20) for line in differences(seed, original, tmp_path)] == []


@pytest.mark.slow
@pytest.mark.parametrize("first", range(20, 200, 20))
def test_two_hundred_variants_are_read_alike(original, tmp_path, first):
    assert [line for seed in range(first, first + 20) for line in differences(seed, original, tmp_path)] == []

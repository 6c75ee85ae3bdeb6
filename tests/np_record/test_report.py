"""Scores, intervals and the report, on recordings made by hand."""

import json

import cv2
import numpy as np
import pytest
from bags import GOAL, KEYPOINT_OFFSET, PERIOD, record_episode
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Writer
from std_msgs.msg import String

from np_common.intervals import wilson_interval
from np_common.rotations import yaw_quaternion
from np_description.domains import CARD, WALL, Pose
from np_description.panda import NOMINAL
from np_description.phases import PhaseState
from np_record.bag import BagError, Recording
from np_record.bag_writer import INCOMPLETE
from np_record.cdr import TYPESTORE
from np_record.commands import report as command
from np_record.outcome import score_outcome
from np_record.recorded_episode import load_episode, read_images
from np_record.report.episodes import make_section, write_report
from np_record.report.third_person import ThirdPerson
from np_record.report.video import write_video


@pytest.mark.parametrize(
    "successes, trials, low, high",
    [
        # Newcombe, Statistics in Medicine 1998, table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_agrees_with_published_values(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(0, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_interval_holds_the_rate_and_is_symmetric(case):
    successes, trials = case
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= (successes / trials if trials else 0.5) <= high <= 1
    mirrored = wilson_interval(trials - successes, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=1e-12)


def test_wilson_interval_refuses_nonsense():
    with pytest.raises(ValueError, match="got 3 of 2"):
        wilson_interval(3, 2)


def pose(x, yaw=0.0):
    return Pose(np.array([x, 0.0, 0.0]), yaw_quaternion(np.asarray(yaw)))


@pytest.mark.parametrize(
    "domain, x, yaw, success",
    [
        (CARD, 0.009, 0.09, True),
        (CARD, 0.011, 0.0, False),
        (CARD, 0.0, 0.11, False),
        (WALL, 0.009, 1.0, True),
    ],
)
def test_the_truth_decides(domain, x, yaw, success):
    outcome = score_outcome(domain, [PhaseState("succeeded")], pose(x, yaw), pose(0.0), 3.0)
    assert outcome.success is success
    assert outcome.failed_in == ("" if success else "post")
    assert (outcome.distance, outcome.angle) == pytest.approx((x, yaw), abs=1e-9)


@pytest.mark.parametrize(
    "declared, reason, failed_in",
    [
        ("failed", "approach: no path in 2.0 s", "approach"),
        ("failed", "pre: no keypoints", "pre"),
        ("fault", "hold", "fault"),
        ("unfinished", "", "unfinished"),
    ],
)
def test_failures_are_named_by_their_phase(declared, reason, failed_in):
    said = [] if declared == "unfinished" else [PhaseState(declared, reason)]
    assert score_outcome(CARD, said, pose(0.1), pose(0.0), 3.0, early=reason).failed_in == failed_in


def test_the_end_tells_the_bounds_of_the_graphs_estimate():
    ends = [PhaseState("succeeded", position_bound="0.0021", angle_bound="0.0140"), PhaseState("failed", "pre: x")]
    told = [score_outcome(CARD, [end], pose(0.0), pose(0.0), 3.0) for end in ends]
    assert [(one.position_bound, one.angle_bound) for one in told] == [(0.0021, 0.014), (None, None)]


def test_contacts_are_counted_up_to_the_end_of_the_episode():
    again = PhaseState("pre", "contact 2: timeout", since="5")
    said = [PhaseState("pre"), PhaseState("approach"), PhaseState("post"), again, PhaseState("succeeded")]
    outcome = score_outcome(CARD, [*said, PhaseState("pre")], pose(0.0), pose(0.0), 3.0)  # the next episode's
    assert (outcome.contacts, outcome.declared, outcome.success) == (2, "succeeded", True)
    assert score_outcome(CARD, [PhaseState("failed", "x")], pose(0.1), pose(0.0), 3.0).contacts == 1


def test_an_episode_is_read_as_recorded(tmp_path):
    with Recording(record_episode(tmp_path / "bag")) as recording:
        episode = load_episode(recording)
        assert len(list(read_images(recording))) == 30
    assert [state.phase for _, state in episode.phases] == ["pre", "approach", "post", "succeeded"]
    assert episode.phases[1][0] == 50 * PERIOD / 1e9
    assert episode.keypoint_error.values == pytest.approx(np.full((30, 8), KEYPOINT_OFFSET), abs=1e-4)
    assert episode.outcome.success and episode.outcome.declared == "succeeded"
    assert episode.position.values.shape == (1500, 7) and episode.command.values.shape == (1500, 7)
    assert episode.wrench.values.shape == (1500, 6)
    assert np.abs(episode.wrench.values).max() == pytest.approx(30, abs=0.1)
    assert episode.distance.values[0] > 0.1 and episode.distance.values[-1] < 0.01


def as_before(bag, path):
    """The same recording as releases before wrote it: the phase as one line of text, on a topic of its own."""
    with Recording(bag) as recording, Writer(path, version=Writer.VERSION_LATEST) as writer:
        connections = {}
        for message in recording.messages():
            name, kind, data = message.topic.name, message.topic.type, message.data
            if name == "episode/phase":
                line = message.decode().status[0].message
                name, kind, data = "phase", "std_msgs/msg/String", serialize_message(String(data=line))
            if name not in connections:
                connections[name] = writer.add_connection(f"/{name}", kind, typestore=TYPESTORE)
            writer.write(connections[name], message.stamp, data)
    return path


def test_an_episode_of_an_earlier_release_is_read_as_one_of_this(tmp_path):
    phases = {0: PhaseState("pre"), 50: PhaseState("failed", "approach: no path: too far")}
    bag = record_episode(tmp_path / "bag", count=200, phases=phases)
    with Recording(bag) as now, Recording(as_before(bag, tmp_path / "before")) as before:
        assert before.counts["phase"] == 2 and "episode/phase" not in before.counts
        episode, former = load_episode(now), load_episode(before)
    assert former.phases == episode.phases and former.outcome == episode.outcome
    assert former.outcome.failed_in == "approach"


def test_an_episode_cut_short_is_unfinished(tmp_path):
    phases = {0: PhaseState("pre"), 50: PhaseState("approach"), 550: PhaseState("post")}
    with Recording(record_episode(tmp_path / "bag", count=600, phases=phases)) as recording:
        outcome = load_episode(recording).outcome
    assert (outcome.declared, outcome.reason, outcome.duration) == ("unfinished", "", 599 * PERIOD / 1e9)


def test_an_episode_whose_disk_became_full_says_so(tmp_path):
    """A recorder in this state ends the bag so; its page would else blame the policy."""
    phases = {0: PhaseState("pre"), 50: PhaseState("approach")}
    why = {INCOMPLETE: "No space left on device, after 5615 messages"}
    with Recording(record_episode(tmp_path / "bag", count=100, phases=phases, information=why)) as recording:
        outcome = load_episode(recording).outcome
    assert outcome.declared == "unfinished"
    assert outcome.reason == "the recording ends early: No space left on device, after 5615 messages"


def test_a_bag_without_the_truth_is_named(tmp_path):
    with (
        Recording(record_episode(tmp_path / "bag", leave_out=["goal_pose"])) as recording,
        pytest.raises(BagError, match="goal_pose for a report"),
    ):
        load_episode(recording)


def test_the_video_plays_back_what_was_drawn(tmp_path):
    with Recording(record_episode(tmp_path / "bag")) as recording:
        episode = load_episode(recording)
        assert write_video(tmp_path / "v.webm", episode, read_images(recording), 10.0) == 30
        assert write_video(tmp_path / "none.webm", episode, [], 10.0) == 0
    assert not (tmp_path / "none.webm").exists()
    capture = cv2.VideoCapture(str(tmp_path / "v.webm"))
    frames = []
    while (read := capture.read())[0]:
        frames.append(read[1])
    assert len(frames) == 30 and frames[0].shape == (448, 896, 3)
    # The goal's outline is drawn in green on a grey image.
    excess = frames[0][60:, :448, 1].astype(int) - frames[0][60:, :448, 2]
    assert (excess > 60).sum() > 50


def test_from_the_side_the_arm_is_where_it_is():
    """The arm is white, the object has its colours, the goal is a green outline; each moves with what it stands for."""
    beside = ThirdPerson(CARD, 448)
    start = Pose(np.array([0.45, -0.1, 0.0025]), np.array([1.0, 0, 0, 0]))
    ready, empty = beside.picture(NOMINAL.ready, start, GOAL), beside.picture(NOMINAL.ready, None, None)
    white = (empty.min(axis=2) > 150).sum()
    assert 2000 < white < 0.4 * empty[..., 0].size
    changed = (ready != empty).any(axis=2)
    assert 50 < changed.sum() < 3000  # object and goal, and nothing else
    turned = beside.picture(np.append(NOMINAL.ready + [0.5, 0, 0, 0, 0, 0, 0], [0.0, 0.0]), start, GOAL)
    assert (turned != ready).any(axis=2).sum() > 5000
    green = ready[changed].astype(int)
    assert ((green[:, 1] - green[:, 0] > 40) & (green[:, 1] - green[:, 2] > 20)).sum() > 20


def test_the_report_is_one_file_with_everything(tmp_path, capsys):
    bag = record_episode(tmp_path / "episode_000", information={"weights": "sha256:abc"})
    assert command.main([str(bag), "--out", str(tmp_path / "report.html")]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["successes"] == 1
    text = (tmp_path / "report.html").read_text()
    assert (
        text.count("<svg") == 8
        and "Depth of contact" in text
        and "Joint speed" in text
        and "External force" in text
        and "data:video/webm;base64," in text
    )
    for expected in (
        "episode_000",
        "succeeded",
        "sha256:abc",
        "approach",
        "effort_command",
        "1 of 1 episodes",
    ):
        assert expected in text
    assert 'src="http' not in text and 'href="http' not in text.replace('href="http://www.w3.org', "")


def test_a_force_that_was_not_recorded_is_not_drawn_and_a_reason_cannot_break_the_page(tmp_path):
    phases = {0: PhaseState("pre"), 150: PhaseState("failed", "pre: <script>alert(1)</script>")}
    section = make_section(record_episode(tmp_path / "bag", 200, phases, leave_out=("external_wrench",)))
    assert "External force" not in section.plots and "largest external force" not in dict(section.facts)
    write_report(tmp_path / "r.html", [section])
    text = (tmp_path / "r.html").read_text()
    assert "alert(1)" in text and "<script>" not in text


def test_a_report_is_called_by_its_domain_and_says_where_the_angle_does_not_count(tmp_path):
    bags = [record_episode(tmp_path / name, count=200, information={"domain": name}) for name in ("card", "wall")]
    card, wall = (make_section(bag) for bag in bags)
    for sections, title, said in (([card], "Card episodes", False), ([wall], "Wall episodes", True)):
        write_report(tmp_path / "r.html", sections)
        text = (tmp_path / "r.html").read_text()
        assert f"<h1>{title}</h1>" in text and ("° (position only)" in text) is said
        assert ("(position only)" in dict(sections[0].facts)["angle to goal"]) is said
        assert "tolerance, 1 cm" in text and ("tolerance, 5.7 deg" in text) is not said
    write_report(tmp_path / "r.html", [card, wall])
    assert "<h1>Card and wall episodes</h1>" in (tmp_path / "r.html").read_text()


def test_the_command_names_a_broken_bag(tmp_path, capsys):
    assert command.main([str(tmp_path / "nothing")]) == 1
    assert "does not exist" in capsys.readouterr().err


def test_the_command_names_a_file_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    bag, out = record_episode(tmp_path / "bag", count=200), tmp_path / "file" / "report.html"
    assert command.main([str(bag), "--out", str(out)]) == 1
    assert f"report: {out}: expected a file that can be written, got: " in capsys.readouterr().err

"""What is said of phases: keys in and out, refused by name where they are not the contract's; old bags too."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_description.phases import PHASES, PhaseState, first_end
from np_record.bag import BagError, Message
from np_record.recorded_phases import read_phase, read_phase_changes
from np_record.topics import BY_NAME
from np_ros.phases import phase_message, phase_state, refusal_message, refusal_reason

texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
stamps = st.just("") | st.integers(0, 2**63).map(str)
bounds = st.just("") | st.floats(0, 1e3).map("{:.4f}".format)
states = st.builds(PhaseState, st.sampled_from(PHASES), texts, texts, stamps, bounds, bounds)


def sent(message):
    """The message as a receiver gets it."""
    return deserialize_message(serialize_message(message), type(message))


def said(*statuses):
    """A message of these statuses: name, and pairs of key and value."""
    return DiagnosticArray(
        status=[
            DiagnosticStatus(name=name, values=[KeyValue(key=key, value=value) for key, value in pairs])
            for name, pairs in statuses
        ]
    )


def recorded(topic, message, stamp=5):
    return Message(stamp, BY_NAME[topic], serialize_message(message))


@given(states, st.integers(0, 2**31 * 10**9 - 1))
def test_what_is_said_is_heard_live_and_from_a_bag(state, stamp):
    message = sent(phase_message(state, stamp))
    assert phase_state(message) == state and stamp_nanoseconds(message.header.stamp) == stamp
    assert read_phase("bag", recorded("episode/phase", message)) == state
    assert read_phase("bag", recorded("episode/tick", message)) == state


@pytest.mark.parametrize(
    "state, text, level",
    [
        (PhaseState("post"), "post", DiagnosticStatus.OK),
        (PhaseState("failed", "post: timeout"), "failed: post: timeout", DiagnosticStatus.ERROR),
        (PhaseState("fault", "stopped: joint 3"), "fault: stopped: joint 3", DiagnosticStatus.ERROR),
        (PhaseState("excite", experiment="dwell"), "excite: dwell", DiagnosticStatus.OK),
    ],
)
def test_people_read_one_line_and_a_level(state, text, level):
    (status,) = phase_message(state).status
    assert (status.name, status.message, status.level) == ("episode", text, level)
    assert {pair.key: pair.value for pair in status.values} == state.values


def test_keys_without_content_are_the_same_as_none_and_others_are_passed_over():
    pairs = [("phase", "pre"), ("reason", ""), ("experiment", ""), ("colour", "blue")]
    assert phase_state(said(("episode", pairs))) == PhaseState("pre")


@pytest.mark.parametrize(
    "message, kind, text",
    [
        (said(), "names", r"expected one status, 'episode', got \[\]"),
        (said(("approach", [("phase", "pre")])), "names", "got \\['approach'\\]"),
        (said(*[("episode", [("phase", "pre")])] * 2), "names", "expected one status"),
        (said(("episode", [("phase", "pre"), ("phase", "post")])), "names", "expected each key once"),
        (said(("episode", [("reason", "why not")])), "range", "expected the key phase, got reason"),
        (said(("episode", [("phase", "pre: soon")])), "range", "expected one of idle, .*, got 'pre: soon'"),
        (said(("episode", [("phase", "failed"), ("angle_bound", "nan")])), "range", "angle_bound: .*, got 'nan'"),
    ],
)
def test_what_says_no_phase_is_refused_by_name(message, kind, text):
    with pytest.raises(BadMessage, match=text) as refused:
        phase_state(sent(message))
    assert refused.value.kind == kind


def test_a_refusal_has_its_reason_and_the_stamp_that_it_answers():
    message = sent(refusal_message(7, "unreachable: far away"))
    assert refusal_reason(message) == "unreachable: far away" and stamp_nanoseconds(message.header.stamp) == 7
    assert message.status[0].level == DiagnosticStatus.ERROR
    with pytest.raises(BadMessage, match="expected the key reason, got \\['why'\\]"):
        refusal_reason(said(("approach", [("why", "far away")])))


@given(states)
def test_the_first_end_counts(state):
    ends = [PhaseState("failed", "post: timeout"), PhaseState("idle")]
    found = first_end([PhaseState("post"), state, *ends])
    assert found == (state if state.phase in ("succeeded", "failed", "fault") else ends[0])


@pytest.mark.parametrize(
    "text, state",
    [
        ("pre", PhaseState("pre")),
        ("failed: approach: no path: too far", PhaseState("failed", "approach: no path: too far")),
        ("excite: dwell", PhaseState("excite", experiment="dwell")),
    ],
)
def test_bags_of_before_are_read(text, state):
    assert read_phase_changes("bag", {"phase": [recorded("phase", String(data=text))]}) == [(5, state)]


def test_a_bag_with_both_is_read_by_the_newer_topic_and_one_with_neither_says_nothing():
    both = {
        "phase": [recorded("phase", String(data="pre"))],
        "episode/phase": [recorded("episode/phase", phase_message(PhaseState("post")))],
    }
    assert read_phase_changes("bag", both) == [(5, PhaseState("post"))]
    assert read_phase_changes("bag", {"phase": []}) == []


@pytest.mark.parametrize(
    "message",
    [
        recorded("phase", String(data="nonsense")),
        recorded("episode/phase", DiagnosticArray()),
        Message(5, BY_NAME["episode/phase"], b"\0\1\0\0"),
    ],
)
def test_a_recorded_message_that_says_no_phase_is_named(message):
    with pytest.raises(BagError, match=f"bag x: {message.topic.name} at 5 ns: expected a phase, got"):
        read_phase_changes("bag x", {message.topic.name: [message]})

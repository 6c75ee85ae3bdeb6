"""What the driver tells of its states: nothing that lasts is left out, and nothing is told too often."""

from hypothesis import given
from hypothesis import strategies as st

from np_control.safety import State
from np_franka.state_throttle import PASSING, REPORTED_EVERY, StateChangeThrottle

CYCLE = 1_000_000  # ns
LASTING = REPORTED_EVERY // CYCLE
stretches = st.lists(st.tuples(st.sampled_from(State), st.integers(1, 2 * LASTING)), min_size=1)


def told(telling, states):
    """(cycle, state) of what is told of a state in each cycle."""
    return [(n, state) for n, state in enumerate(states) if telling.is_due(n * CYCLE, state, f"is {state}")]


@given(stretches)
def test_what_lasts_is_told_and_what_does_not_pass_is_told_at_once(parts):
    states = [state for state, cycles in parts for _ in range(cycles)]
    said = dict(told(StateChangeThrottle(), states))
    known, begin = None, 0
    for n, state in enumerate(states):
        begin = n if n == 0 or states[n - 1] != state else begin
        known = said.get(n, known)
        assert known == state or {known, state} == set(PASSING) and n - begin < LASTING


@given(stretches)
def test_moving_and_holding_in_turn_are_told_ten_times_a_second(parts):
    states = [state for state, cycles in parts for _ in range(cycles)]
    said = told(StateChangeThrottle(), states)
    for (n, before), (m, after) in zip(said, said[1:]):
        assert before != after
        assert m - n >= LASTING or {before, after} != set(PASSING)


def test_a_hold_that_begins_at_once_is_told_before_silence_ends_it():
    states = [State.READY] + 8 * [State.MOVING] + 192 * [State.HOLDING] + [State.STOPPED]
    assert [state for _, state in told(StateChangeThrottle(), states)] == [
        State.READY,
        State.MOVING,
        State.HOLDING,
        State.STOPPED,
    ]


def test_another_cause_of_the_same_state_is_told():
    telling = StateChangeThrottle()
    assert telling.is_due(0, State.FAULT, "a reflex")
    assert not telling.is_due(CYCLE, State.FAULT, "a reflex")
    assert telling.is_due(2 * CYCLE, State.FAULT, "the connection")

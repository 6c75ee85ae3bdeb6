"""The watchdog against a model of its rules, over random sequences of events."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from np_control.safety import LIMITS, Reason, Refusal, State, Watchdog


class Events(RuleBasedStateMachine):
    """Random events; the rules below are the contract of docs/reference/graph.md, written from the outside."""

    def __init__(self):
        super().__init__()
        self.dog = Watchdog(LIMITS)
        self.now = 0
        self.last_command = None
        self.latched = False  # stopped or faulted and not recovered
        self.stopped = False

    def refused(self, event, *arguments):
        try:
            event(*arguments)
        except Refusal as refusal:
            return refusal.reason
        return None

    @rule(periods=st.integers(1, 120))
    def wait(self, periods):
        self.now += periods * LIMITS.period_ns
        if self.dog.poll(self.now) is State.STOPPED and not self.latched:
            assert self.now - self.last_command >= LIMITS.silence_ns
            self.latched = self.stopped = True

    @rule()
    def command(self):
        self.wait(0)
        expected = Reason.STATE if self.latched or self.dog.state is State.IDLE else None
        assert self.refused(self.dog.command, self.now) is expected
        if expected is None:
            self.last_command = self.now
            assert self.dog.poll(self.now) is State.MOVING

    @rule()
    def start(self):
        assert self.refused(self.dog.start) is (Reason.STATE if self.latched else None)
        if not self.latched:
            assert self.dog.state is State.READY

    @rule()
    def stop(self):
        self.dog.stop("test")
        self.latched = self.stopped = True
        assert self.dog.state is State.STOPPED

    @rule()
    def fault(self):
        self.dog.fault("test")
        self.latched = True

    @rule(at_rest=st.booleans())
    def recover(self, at_rest):
        expected = Reason.STATE if not self.latched else None if at_rest else Reason.NOT_AT_REST
        assert self.refused(self.dog.recover, at_rest) is expected
        if expected is None:
            self.latched = self.stopped = False
            assert self.dog.state is State.READY

    @invariant()
    def stop_wins(self):
        if self.stopped:
            assert self.dog.state is State.STOPPED

    @invariant()
    def only_recover_leads_out(self):
        assert self.latched == (self.dog.state in (State.STOPPED, State.FAULT))
        assert self.dog.may_move == (self.dog.state in (State.READY, State.MOVING, State.HOLDING))

    @invariant()
    def silence_is_bounded(self):
        if self.dog.poll(self.now) in (State.MOVING, State.HOLDING):
            silence = self.now - self.last_command
            assert silence < LIMITS.silence_ns
            assert (silence > LIMITS.missed_periods * LIMITS.period_ns) == (self.dog.state is State.HOLDING)


Events.TestCase.settings = settings(max_examples=60, stateful_step_count=30)
TestWatchdog = Events.TestCase


def test_a_hold_keeps_its_words_as_long_as_it_lasts():
    """A backend tells every new cause at once: words that changed would cost it a message a period."""
    dog = Watchdog(LIMITS)
    dog.start()
    dog.command(0)
    last = LIMITS.silence_ns // LIMITS.period_ns
    told = {(dog.poll(n * LIMITS.period_ns), dog.cause) for n in range(LIMITS.missed_periods + 1, last)}
    assert told == {(State.HOLDING, "missed: no command for more than 6 ms")}
    assert dog.poll(LIMITS.silence_ns) is State.STOPPED and dog.cause == "silence: no command for 200 ms"

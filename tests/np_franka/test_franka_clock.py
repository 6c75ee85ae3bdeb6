"""Stamps that go with the robot's clock and stay with the host's; what diagnostics say of that. No hardware extra
needed."""

import numpy as np
import pytest

from np_control.safety import State
from np_franka.clock import SLEW, WINDOW, RobotClock
from np_franka.limits import CYCLE_NS
from np_franka.nodes.condition import ERROR, OK, WARN, condition

EPOCH = 1_790_000_000_000_000_000  # ns
DELAY = 50_000  # ns on average, from a state to its arrival


class Cycles:
    """A robot whose clock gains `drift` s/s on the host's, and whose states now and then come 100 ms late."""

    def __init__(self, drift=0.0, delay=DELAY):
        self._drift, self._delay = drift, delay
        self._rng, self._count = np.random.default_rng(0), 0
        self.clock = RobotClock()
        self.clock.begin(0, EPOCH, CYCLE_NS)

    def run(self, seconds):
        """Stamps (n,) ns and how far each is behind the host's clock, (n,) ns."""
        counts = self._count + np.arange(1, round(seconds * 1e9 / CYCLE_NS) + 1)
        taken = np.rint(counts * CYCLE_NS / (1 + self._drift)).astype(np.int64)
        late = self._rng.exponential(self._delay, counts.size) + 1e8 * (self._rng.random(counts.size) < 0.01)
        stamps = [
            self.clock.go_on(int(count) * CYCLE_NS, EPOCH + int(at))
            for count, at in zip(counts, taken + late.astype(np.int64))
        ]
        self._count = int(counts[-1])
        return np.array(stamps), taken - (np.array(stamps) - EPOCH)


@pytest.mark.parametrize("drift", [-100e-6, 0.0, 100e-6])
def test_stamps_stay_with_the_hosts_clock_and_go_as_the_robots_does(drift):
    cycles = Cycles(drift)
    stamps, behind = cycles.run(120)
    assert np.abs(behind).max() < 0.25e6  # two windows' drift; 12 ms without
    assert np.abs(np.diff(stamps) - CYCLE_NS).max() <= SLEW * CYCLE_NS + 1
    assert abs(cycles.clock.lag) < 0.25e6


def test_a_host_clock_that_was_set_is_told_and_followed_without_a_step():
    cycles = Cycles()
    cycles.run(5)
    for step in (30_000_000, -60_000_000):  # ns
        cycles.clock._origin -= step
        stamps, behind = cycles.run(3)
        assert cycles.clock.lag == pytest.approx(behind[-1], abs=1e6)
        assert abs(behind[-1]) < abs(behind[0]) - 1e9 * SLEW  # at full pace from the second window on
        assert np.abs(np.diff(stamps) - CYCLE_NS).max() <= SLEW * CYCLE_NS + 1


def test_late_arrivals_are_no_drift():
    clock = RobotClock()
    clock.begin(0, EPOCH, CYCLE_NS)
    for k in range(1, 5 * WINDOW // CYCLE_NS):
        is_late = k % 100  # all but one in a hundred
        clock.go_on(k * CYCLE_NS, EPOCH + k * CYCLE_NS + is_late * 50_000)
    assert clock.lag == 0 and clock.stamp == EPOCH + k * CYCLE_NS


def test_another_connection_begins_at_the_hosts_time_and_never_before_the_last_stamp():
    clock = RobotClock()
    assert clock.begin(7 * CYCLE_NS, EPOCH, CYCLE_NS) == EPOCH
    last = clock.go_on(9 * CYCLE_NS, EPOCH + CYCLE_NS)
    assert clock.begin(0, EPOCH, CYCLE_NS) == last + CYCLE_NS
    assert clock.begin(0, EPOCH + WINDOW, CYCLE_NS) == EPOCH + WINDOW == clock.go_on(1, EPOCH + WINDOW) - 1


@pytest.mark.parametrize(
    "state, hand, lag, level, words",
    [
        (State.MOVING, "", 19.0, OK, "moving: why"),
        (State.MOVING, "", 21.0, WARN, "moving: why; clock: 21 ms behind the host's"),
        (State.MOVING, "", -99.0, WARN, "moving: why; clock: 99 ms ahead of the host's"),
        (State.MOVING, "blocked", 0.0, WARN, "moving: why; hand: blocked"),
        (State.READY, "blocked", -101.0, ERROR, "ready: why; hand: blocked; clock: 101 ms ahead of the host's"),
        (State.HOLDING, "", 0.0, WARN, "holding: why"),
        (State.FAULT, "blocked", 30.0, ERROR, "fault: why; hand: blocked; clock: 30 ms behind the host's"),
    ],
)
def test_the_worst_counts_and_everything_is_said(state, hand, lag, level, words):
    assert condition(state, "why", hand, lag) == (level, words)

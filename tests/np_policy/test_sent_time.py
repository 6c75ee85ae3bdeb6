"""Goals are in the order in which they were sent, though the wall clock is set."""

import time

import pytest

from np_description.control_rate import SECOND
from np_policy.sent_time import SentTime


@pytest.fixture
def clocks(monkeypatch):
    now = {"wall": 1000 * SECOND, "steady": 50 * SECOND}
    monkeypatch.setattr(time, "time_ns", lambda: now["wall"])
    monkeypatch.setattr(time, "monotonic_ns", lambda: now["steady"])

    def go_on(seconds, jump=0):
        now["steady"] += seconds * SECOND
        now["wall"] += (seconds + jump) * SECOND

    return now, go_on


@pytest.mark.parametrize("jump", [-20, 20])
def test_a_goal_sent_after_the_clock_was_set_is_the_newer_one(clocks, jump):
    now, go_on = clocks
    sent = SentTime()
    first = sent.steady(now["wall"])
    go_on(3, jump)
    assert sent.steady(now["wall"]) == first + 3 * SECOND


@pytest.mark.parametrize("waited", [1, 12, 30])
@pytest.mark.parametrize("jump", [-20, 20])
def test_an_old_latched_goal_stays_the_older_one(clocks, jump, waited):
    now, go_on = clocks
    sent = SentTime()
    old = now["wall"]
    go_on(5)
    newer = sent.steady(now["wall"])
    go_on(waited, jump)
    assert sent.steady(old) < newer

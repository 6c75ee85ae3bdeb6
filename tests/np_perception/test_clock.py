"""The camera's clock: stamps grow, follow the drift, and do not believe late frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from np_perception.camera.frame_clock import JUMP, PATIENCE, SECOND, ClockMapper

PERIOD = SECOND // 30
LEAST = 8_000_000  # ns, delay that every frame has
EPOCH = 1_700_000_000 * SECOND


def frames(seconds, drift, seed, late=0.05, wraps=0, begin=4000 * SECOND):
    """True time, camera's time, arrival ns of frames with random delays, some of them very late."""
    rng, last = np.random.default_rng(seed), 0
    for i in range(round(seconds * 30)):
        taken = i * PERIOD
        device = begin + round(taken * (1 + drift))
        delay = LEAST + round(rng.exponential(2e6)) + (round(rng.uniform(0, 0.2) * 1e9) if rng.random() < late else 0)
        last = max(last + 1, EPOCH + taken + delay)  # a late frame holds up those behind it
        yield EPOCH + taken, device % wraps if wraps else device, last


@settings(max_examples=10)
@given(st.floats(-100e-6, 100e-6), st.integers(0, 10**6), st.sampled_from([0, 2**32 * 1000]))
def test_stamps_follow_the_camera_within_a_fraction_of_a_millisecond(drift, seed, wraps):
    mapper, last = ClockMapper(wraps), -1
    # begins 20 s before the counter of 32 bits begins anew
    for number, (taken, device, arrival) in enumerate(
        frames(40, drift, seed, wraps=wraps, begin=2**32 * 1000 - 20 * SECOND)
    ):
        stamp = mapper.map(device, arrival)
        assert last < stamp <= arrival
        last = stamp
        if number > 30 * 15:
            assert abs(stamp - taken - LEAST) < 300_000
    assert mapper.restarts == 0
    assert mapper.drift == pytest.approx(-drift, abs=5e-6)


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 2**33), st.integers(0, SECOND)), min_size=2, max_size=60))
def test_whatever_comes_stamps_grow_and_are_never_later_than_the_arrival(steps):
    mapper, last, arrival, device = ClockMapper(2**32 * 1000), -1, EPOCH, 0
    for moved, passed in steps:
        device, arrival = (device + moved) % (2**32 * 1000), arrival + passed + 1
        stamp = mapper.map(device, arrival)
        assert last < stamp <= arrival
        last = stamp


def test_a_camera_that_was_plugged_in_again_is_a_new_beginning():
    mapper = ClockMapper()
    for _, device, arrival in frames(12, 30e-6, 0):
        mapper.map(device, arrival)
    stamp = mapper.map(5 * SECOND, arrival + 2 * SECOND)
    assert mapper.restarts == 1 and stamp == arrival + 2 * SECOND


@pytest.mark.parametrize("step", [-3600 * SECOND, 3600 * SECOND])
def test_a_host_clock_that_was_set_is_followed(step):
    mapper = ClockMapper()
    all_frames = list(frames(20, 0.0, 0, late=0.0))
    for _, device, arrival in all_frames[:300]:
        mapper.map(device, arrival)
    stamps = [mapper.map(device, arrival + step) - arrival - step for _, device, arrival in all_frames[300:]]
    assert mapper.restarts == 1
    assert all(abs(error) < 30_000_000 for error in stamps[PATIENCE + 1 :])


def test_a_burst_of_late_frames_moves_nothing():
    mapper = ClockMapper()
    all_frames = list(frames(30, 20e-6, 1, late=0.0))
    for number, (taken, device, arrival) in enumerate(all_frames):
        is_burst = 600 <= number < 600 + PATIENCE
        stamp = mapper.map(device, arrival + (2 * JUMP if is_burst else 0))
        if number > 450:
            assert abs(stamp - taken - LEAST) < 500_000
    assert mapper.restarts == 0

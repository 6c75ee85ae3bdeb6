"""What a backend keeps in real time: it waits for nobody, and silence brings the arm to rest."""

import pytest

from np_evaluation.conformance.checks import CAMERA, CHECKS, PAUSE, REAL_TIME


def asked_of(whom):
    """The checks of a kind of backend, as arguments of a test."""
    return pytest.mark.parametrize("check", [c for c in CHECKS if c.asked_of == whom], ids=lambda c: c.run.__name__)


@asked_of(REAL_TIME)
def test_a_backend_in_real_time_keeps(running_realtime, check):
    running_realtime.keeps(check)


@asked_of(CAMERA)
def test_a_camera_keeps(camera_start, check):
    check.run(camera_start(camera=True))


@asked_of(PAUSE)
def test_time_that_can_stand_still_keeps(pausing_start, check):
    check.run(pausing_start())

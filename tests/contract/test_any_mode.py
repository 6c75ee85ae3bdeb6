"""What every backend keeps in every mode."""

import signal

import pytest

from np_evaluation.conformance.checks import ANY, CHECKS


@pytest.mark.parametrize("check", [c for c in CHECKS if c.asked_of == ANY], ids=lambda c: c.run.__name__)
def test_every_backend_keeps(running, check):
    running.keeps(check)


def test_the_backend_ends_cleanly(running):
    """Last: nothing is asked of it afterwards."""
    harness = running.harness()
    harness.follow(harness.commands.stay, lambda: len(harness.states) > 20, "20 states")
    assert harness.graph.kill(harness.backend.name, signal.SIGINT) == 0

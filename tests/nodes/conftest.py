"""Nodes as simulated processes, see simulated_tools."""

import pytest
from simulated_tools import SimulatedGraph, SimulatedProbe


@pytest.fixture
def graph():
    """Starts nodes."""
    return SimulatedGraph()


@pytest.fixture
def probe(graph):
    """A peer of the nodes of `graph`."""
    return SimulatedProbe(graph)

"""Nodes as simulated processes, see simulated_tools."""

import pytest
from simulated_tools import InProcessGraph, InProcessProbe


@pytest.fixture
def graph():
    """Starts nodes."""
    return InProcessGraph()


@pytest.fixture
def probe(graph):
    """A peer of the nodes of `graph`."""
    return InProcessProbe(graph)

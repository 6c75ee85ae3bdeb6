"""What may touch what: training's scene and the graph's."""

import pytest

from np_description.domains import DOMAINS
from np_description.scene import load_model


def touching(model, domain) -> set[str]:
    """Names of the robot's geoms that may touch the object."""
    thing = model.geom("object")
    geoms = (model.geom(i) for i in range(model.ngeom))
    return {
        geom.name
        for geom in geoms
        if geom.name.startswith("panda") and (geom.contype & thing.conaffinity or thing.contype & geom.conaffinity)
    }


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_what_stands_beside_the_hand_touches_in_training_as_in_the_graph(domain):
    graph, training = (touching(load_model(domain, arm_collision=whole), domain) for whole in (True, False))
    near = {n for n in graph if not n.startswith("panda_link") or n.startswith("panda_link7")}
    assert any(n.startswith("panda_link7") for n in near)
    assert training == near

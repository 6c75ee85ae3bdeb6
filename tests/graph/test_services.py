"""Asking a service: before its node is there, once and no more, and of a node that has nothing else to ask."""

import pytest
from graph_tools import Apart
from std_srvs.srv import Trigger


class Server(Apart):
    """A node `counter`, whose service `~/add` says how often it was asked."""

    def __init__(self, graph, parameter_services):
        super().__init__("counter", graph.domain_id, start_parameter_services=parameter_services)
        self.count = 0
        self.node.create_service(Trigger, "~/add", self._add)
        self.begin()

    def _add(self, request, response):
        self.count += 1
        response.success, response.message = True, str(self.count)
        return response


@pytest.mark.parametrize("parameter_services", [True, False])
def test_a_service_is_asked_once_also_of_a_node_that_has_just_started(graph, probe, parameter_services):
    with pytest.raises(TimeoutError, match="the service counter/add"):
        probe.call("counter/add", timeout=0.1)
    server = Server(graph, parameter_services)
    try:
        for number in range(1, 4):
            assert probe.call("counter/add").message == str(number)
    finally:
        server.close()
    assert server.count == 3

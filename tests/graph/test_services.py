"""Asking a service: before its node is there, once and no more, and of a node that has nothing else to ask."""

from threading import Thread

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_srvs.srv import Trigger


class Server:
    """A node `counter` in a context of its own, whose service `~/add` says how often it was asked."""

    def __init__(self, graph, parameter_services):
        self.count = 0
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=graph.domain_id)
        self._node = rclpy.create_node("counter", context=self._context, start_parameter_services=parameter_services)
        self._node.create_service(Trigger, "~/add", self._add)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin)
        self._thread.start()

    def close(self):
        rclpy.shutdown(context=self._context)
        self._thread.join()
        self._node.destroy_node()

    def _spin(self):
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

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

"""Calls of services, also of nodes that have only just started."""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.srv import GetParameterTypes
from rclpy.client import Client
from rclpy.node import Node

_AGAIN = 0.5  # s

Wait = Callable[[Callable[[], object], float, str], None]


class Services:
    """The services that `node` calls; wait(condition, timeout s, what) spins it until the condition holds.

    A client sees when it has found a service, not when the service has found the client: a response sent before
    that is dropped, and never comes. A second call would be wrong: a second reset draws another episode. So the
    serving node first gets a request without effect, as often as it takes: the types of no parameters. DDS announces
    the readers of a process in the order in which they were made. A server that responds to the one made last has
    found those made before. A node without parameter services is called at once.
    """

    def __init__(self, node: Node, wait: Wait):
        self._node, self._wait = node, wait
        self._clients: dict[str, tuple[Client, Client]] = {}

    def find(self, kind: type, name: str, timeout: float) -> None:
        """Wait until the service <node>/<name> of type `kind` is there; raises what `wait` raises after `timeout` s."""
        if name not in self._clients:
            harmless = f"{name.rpartition('/')[0]}/get_parameter_types"
            self._clients[name] = (
                self._node.create_client(kind, name),
                self._node.create_client(GetParameterTypes, harmless),
            )
        self._wait(self._clients[name][0].service_is_ready, timeout, f"the service {name}")

    def call(self, kind: type, name: str, request, timeout: float):
        """The response of the service <node>/<name> of type `kind`; raises what `wait` raises after `timeout` s."""
        self.find(kind, name, timeout)
        client, harmless = self._clients[name]
        if harmless.service_is_ready():  # found before the other, if it is there: a node makes it first
            self._be_found(harmless, timeout, f"a sign that {name} has found this client")
        future = client.call_async(request)
        self._wait(future.done, timeout, f"a response of {name}")
        return future.result()

    def be_found(self, node: str, timeout: float) -> None:
        """Wait until `node`, which has parameter services, has found whatever this one has made so far.

        Raises what `wait` raises after `timeout` s. A publisher sees when it has found a subscriber, not when that one has found it.
        Until then its messages wait, and come after those that are sent on other topics meanwhile.
        """
        harmless = self._node.create_client(GetParameterTypes, f"{node}/get_parameter_types")
        try:
            self._wait(harmless.service_is_ready, timeout, f"the parameter services of {node}")
            self._be_found(harmless, timeout, f"a sign that {node} has found this client")
        finally:
            self._node.destroy_client(harmless)

    def _be_found(self, harmless: Client, timeout: float, what: str) -> None:
        """Repeat the request until a response comes."""
        futures, again = [], 0.0

        def answered() -> bool:
            nonlocal again
            if time.monotonic() >= again:
                futures.append(harmless.call_async(GetParameterTypes.Request()))
                again = time.monotonic() + _AGAIN
            return any(future.done() for future in futures)

        try:
            self._wait(answered, timeout, what)
        finally:
            for future in futures:
                harmless.remove_pending_request(future)

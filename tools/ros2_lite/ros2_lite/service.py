"""`ros2 service list|call`."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable

import yaml

from ros2_lite import graph


def list_services(show_types: bool) -> int:
    """Print the services of the graph."""
    with graph.node() as node:
        graph.discover(node)
        graph.print_names(node.get_service_names_and_types(), show_types)
    return 0


def service_type(name: str) -> type:
    """The class of "package/srv/Name". Raises ValueError for what is none."""
    package, _, service = name.partition("/srv/")
    try:
        return getattr(importlib.import_module(f"{package}.srv"), service)
    except (ImportError, AttributeError, TypeError, ValueError):
        raise ValueError(f"service type: expected one as std_srvs/srv/Trigger, got {name!r}") from None


def fill(message: object, values: object) -> None:
    """Set fields of a message from dictionaries, nested as the message is. Raises ValueError for others, or other types."""
    known = message.get_fields_and_field_types()
    if not isinstance(values, dict) or not values.keys() <= known.keys():
        raise ValueError(f"request: expected fields of {known}, got {values}")
    for name, value in values.items():
        if hasattr(own := getattr(message, name), "get_fields_and_field_types"):
            fill(own, value)
            continue
        try:
            type(message)(check_fields=True, **{name: value})  # as it comes, a message takes anything
            setattr(message, name, value)
        except AssertionError as error:
            raise ValueError(f"request: {name}: expected {known[name]}, got {value!r}") from error


def call(name: str, type_name: str, values: str) -> int:
    """Call a service, once it is there, with the fields that the YAML `values` gives; prints request and response."""
    kind = service_type(type_name)
    request = kind.Request()
    try:
        fill(request, yaml.safe_load(values) or {})
    except yaml.YAMLError as error:
        raise ValueError(f"request: expected YAML, got {values!r}: {error}") from None
    from np_ros.client.services import Services

    with graph.node() as node:

        def wait(condition: Callable[[], object], timeout: float, what: str) -> None:
            if not condition():
                print(f"waiting for {what}", file=sys.stderr)
            while not condition():
                graph.spin_once(node, 0.1)

        print(f"requester: making request: {request}\n", flush=True)
        response = Services(node, wait).call(kind, name, request, math.inf)
        print(f"response:\n{response}\n")
    return 0

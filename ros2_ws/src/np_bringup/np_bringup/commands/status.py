"""`status`: a table of all nodes of the graph in this ROS_DOMAIN_ID: level, message, and counts of refusals."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from contextlib import closing, suppress
from typing import TYPE_CHECKING

from np_common.cli import Parser

if TYPE_CHECKING:  # slow to import
    from np_ros.client.graph_client import GraphClient

PATIENCE = 10.0  # s for nodes that publish diagnostics, of which none have come
LEVELS = ("OK", "WARN", "ERROR", "STALE")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="status", description=__doc__.partition(": ")[2])
    p.add_argument(
        "--seconds", type=float, default=2.5, help="how long to listen; nodes report every second; %(default)g"
    )
    p.add_argument("--namespace", default="", help="of the nodes, as in the launch")
    p.add_argument("--json", action="store_true", help="all values that the nodes report, as JSON")
    return p


def format_status(found: Mapping[str, Mapping]) -> str:
    """A line a node, those with an error first; with counts other than 0 of what it refused, dropped or missed."""
    rows = sorted(found.items(), key=lambda item: (-item[1]["level"], item[0]))
    wide = max(map(len, found))
    lines = [f"{'node':{wide}}  level  message; counts"]
    for name, status in rows:
        counts = [
            f"{key} {value}"
            for key, value in status["values"].items()
            if key.startswith(("refused_", "dropped_", "missed_")) and value not in ("0", "")
        ]
        lines.append(f"{name:{wide}}  {LEVELS[status['level']]:5}  {'; '.join([status['message'], *counts])}")
    return "\n".join(lines)


def _reporting(client: GraphClient, namespace: str) -> set[str]:
    """Full names of the nodes that publish diagnostics."""
    ends = client.node.get_publishers_info_by_topic(f"{namespace}/diagnostics")
    return {f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends}


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the executable `status`. Status 1: a node reports an error, or none reports."""
    options = parser().parse_args(arguments)
    from diagnostic_msgs.msg import DiagnosticArray

    from np_ros import qos
    from np_ros.client.graph_client import GraphClient
    from np_ros.processes.domain import ros_domain_id

    found: dict[str, dict] = {}

    def keep(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            found[status.name] = {"level": min(status.level[0], 3), "message": status.message, "values": values}

    try:
        number = ros_domain_id()
        with closing(GraphClient("status")) as client:
            client.collect(f"{options.namespace}/diagnostics", DiagnosticArray, qos.RECORDER, keep)
            client.idle_for(options.seconds)
            with suppress(TimeoutError):
                client.wait_until(lambda: _reporting(client, options.namespace) <= set(found), PATIENCE)
            for name in _reporting(client, options.namespace) - set(found):
                found[name] = {"level": 3, "message": f"no report within {PATIENCE:g} s", "values": {}}
    except KeyboardInterrupt:
        return 0
    except ValueError as error:
        print(f"status: {error}", file=sys.stderr)
        return 1
    if not found:
        print(f"status: no diagnostics in ROS_DOMAIN_ID {number} within {options.seconds:g} s", file=sys.stderr)
        return 1
    print(json.dumps(found, indent=1) if options.json else format_status(found))
    return int(any(status["level"] == 2 for status in found.values()))


if __name__ == "__main__":
    raise SystemExit(main())

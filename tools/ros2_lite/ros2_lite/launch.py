"""`ros2 launch` for launch files that are one table of nodes (np_ros.processes.graph).

Such a file defines `ARGUMENTS`, a list of LaunchArgument, and `graph(arguments) -> list[NodeSpec]`. With the
real ros2, its generate_launch_description() makes a LaunchDescription of the same table.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from ros2_lite.packages import prefix_of

_PERIOD = 0.1  # s between two looks at the processes


def files(package: str) -> list[Path]:
    """The launch files of a package. Raises LookupError where it is not installed."""
    return sorted((prefix_of(package) / "share" / package / "launch").glob("*.launch.py"))


def load(package: str, file: str) -> dict:
    """The names a package's launch file defines. Raises LookupError if there is no such file."""
    found = {path.name: path for path in files(package)}
    if file not in found:
        raise LookupError(f"No launch file '{file}' in package '{package}'; it has: {', '.join(found) or 'none'}")
    return runpy.run_path(str(found[file]))


def parse(pairs: Sequence[str]) -> dict[str, str]:
    """name:=value pairs as a dictionary. Raises ValueError for anything else."""
    for pair in pairs:
        if ":=" not in pair:
            raise ValueError(f"launch argument: expected name:=value, got '{pair}'")
    return dict(pair.split(":=", 1) for pair in pairs)


def launch(package: str, file: str, pairs: Sequence[str], show_arguments: bool) -> int:
    """Run the nodes of a launch file until Ctrl-C, SIGTERM or the end of all; 1 if one of them failed."""
    names = load(package, file)
    if show_arguments:
        for argument in names["ARGUMENTS"]:
            print(f"'{argument.name}': {argument.description} (default: '{argument.default}')")
        return 0

    from np_ros.processes.graph import complete
    from np_ros.processes.supervisor import Supervisor

    nodes = names["graph"](complete(parse(pairs), names["ARGUMENTS"]))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logs = Path(tempfile.mkdtemp(prefix="ros2_launch_"))
    print(f"logs are in {logs}", flush=True)
    failed = False
    with Supervisor(logs, domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0"))) as supervisor:
        supervisor.start(nodes)
        running = {node.name: open(logs / f"{node.name}.log", errors="replace") for node in nodes}
        required = {node.name for node in nodes if node.is_required}
        try:
            while required <= set(running) and running:
                time.sleep(_PERIOD)
                for name, log in list(running.items()):
                    ended = supervisor.ended(name)
                    for line in log:
                        print(f"[{name}] {line}", end="" if line.endswith("\n") else "\n", flush=True)
                    if ended:
                        status = supervisor.kill(name)
                        failed |= status != 0
                        print(f"[{name}] has ended with status {status}", file=sys.stderr, flush=True)
                        running.pop(name).close()
            for name in required - set(running):
                print(f"nothing goes on without {name}: the launch ends", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            pass
        finally:
            for log in running.values():
                log.close()
    return int(failed)

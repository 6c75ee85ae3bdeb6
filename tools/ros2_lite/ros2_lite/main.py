"""Entry point: hand over to a real `ros2` if there is one, else run the sub-command here."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import NoReturn

from ros2_lite import ending


def real_ros2(path: str, own: Path) -> str | None:
    """The first executable `ros2` on the search path that is not in our own folder and not this command in the environment
    of another checkout, which would hand back to us, or None."""
    for folder in path.split(os.pathsep):
        candidate = Path(folder or ".") / "ros2"
        if (
            os.access(candidate, os.X_OK)
            and candidate.resolve().parent != own
            and b"from ros2_lite." not in candidate.read_bytes()
        ):
            return str(candidate)
    return None


class CommandParser(argparse.ArgumentParser):
    """Reports an error in one line; for an unknown command it refers to a full ROS 2."""

    def error(self, message: str) -> NoReturn:
        more = "; a whole ROS 2 has more" if "invalid choice" in message else ""
        self.exit(2, f"{self.prog}: {message}{more}; see --help\n")


def parser() -> argparse.ArgumentParser:
    """The command line; names and meaning as in ros2cli."""
    root = CommandParser(prog="ros2", description="A small part of the ros2 command.")
    commands = root.add_subparsers(dest="command", required=True, metavar="command")

    run = commands.add_parser("run", help="run an executable of a package")
    run.add_argument("package")
    run.add_argument("executable")
    passed_on = run.add_argument("arguments", nargs=argparse.REMAINDER, help="passed on, --ros-args included")
    passed_on.required = False  # which argparse takes any rest to be

    pkg = commands.add_parser("pkg", help="what is installed").add_subparsers(dest="verb", required=True)
    executables = pkg.add_parser("executables", help="executables, of one package or of all")
    executables.add_argument("package", nargs="?")

    topic = commands.add_parser("topic", help="what is sent").add_subparsers(dest="verb", required=True)
    names = topic.add_parser("list", help="names of the topics")
    names.add_argument("-t", "--show-types", action="store_true")
    details = topic.add_parser("info", help="type, publishers and subscribers of a topic")
    details.add_argument("topic")
    details.add_argument("-v", "--verbose", action="store_true", help="their nodes and quality of service")
    publish = topic.add_parser("pub", help="publish a message")
    publish.add_argument("topic")
    publish.add_argument("type", help="for example std_msgs/msg/Float64")
    publish.add_argument("values", nargs="?", default="{}", help="fields of the message as YAML")
    publish.add_argument("-1", "--once", action="store_true", help="once, as soon as somebody subscribes")
    publish.add_argument("-r", "--rate", type=float, default=1.0, help="messages a second; %(default)g")
    echo = topic.add_parser("echo", help="print messages as YAML")
    echo.add_argument("topic")
    echo.add_argument("--once", action="store_true", help="end after the first message")
    echo.add_argument("--full-length", "-f", action="store_true", help="print arrays in full")
    hz = topic.add_parser("hz", help="print the rate at which messages come")
    hz.add_argument("topic")
    hz.add_argument("--window", "-w", type=int, default=10000, help="messages the rate is computed over")

    service = commands.add_parser("service", help="list and call services").add_subparsers(dest="verb", required=True)
    names = service.add_parser("list", help="names of the services")
    names.add_argument("-t", "--show-types", action="store_true")
    call = service.add_parser("call", help="call a service and print its response")
    call.add_argument("service")
    call.add_argument("type", help="for example std_srvs/srv/Trigger")
    call.add_argument("values", nargs="?", default="{}", help="fields of the request as YAML")

    node = commands.add_parser("node", help="nodes of the graph").add_subparsers(dest="verb", required=True)
    node.add_parser("list", help="full names of the nodes")

    param = commands.add_parser("param", help="parameters of a node").add_subparsers(dest="verb", required=True)
    for verb, words in (("list", "names"), ("get", "value of one"), ("set", "change one")):
        one = param.add_parser(verb, help=words)
        one.add_argument("node", help="full name, as /episode")
        if verb != "list":
            one.add_argument("name")
        if verb == "set":
            one.add_argument("value", help="as YAML")

    launch = commands.add_parser("launch", help="run a launch file of this project")
    launch.add_argument("package")
    launch.add_argument("file")
    launch.add_argument("arguments", nargs="*", metavar="name:=value")
    launch.add_argument("-s", "--show-args", action="store_true", help="list the launch arguments and end")
    return root


def execute(arguments: argparse.Namespace) -> int:
    """Run one command; its exit status. Only what looks at a graph imports rclpy."""
    if arguments.command in ("run", "pkg"):
        from ros2_lite import packages

        if arguments.command == "run":
            return packages.run(arguments.package, arguments.executable, arguments.arguments)
        return packages.list_executables(arguments.package)
    if arguments.command == "launch":
        from ros2_lite import launch

        return launch.launch(arguments.package, arguments.file, arguments.arguments, arguments.show_args)
    from ros2_lite import nodes, service, topic

    a = arguments
    match a.command, a.verb:
        case "service", "list":
            return service.list_services(a.show_types)
        case "service", _:
            return service.call(a.service, a.type, a.values)
        case "node", _:
            return nodes.list_nodes()
        case "param", "list":
            return nodes.list_parameters(a.node)
        case "param", "get":
            return nodes.get_parameter(a.node, a.name)
        case "param", _:
            return nodes.set_parameter(a.node, a.name, a.value)
        case _, "list":
            return topic.list_topics(a.show_types)
        case _, "info":
            return topic.info(a.topic, a.verbose)
        case _, "echo":
            return topic.echo(a.topic, a.once, a.full_length)
        case _, "pub":
            return topic.pub(a.topic, a.type, a.values, a.once, a.rate)
    return topic.hz(a.topic, a.window)


def main() -> int:
    """Run `ros2 ...`; the exit status."""
    if sys.argv[1:2] == ["--complete"]:
        from ros2_lite import completion

        print("\n".join(completion.candidates(parser(), *completion.words(os.environ))))
        return 0
    real = real_ros2(os.environ.get("PATH", ""), Path(sys.argv[0]).resolve().parent)
    if real:
        os.execv(real, [real, *sys.argv[1:]])
    arguments = parser().parse_args()
    if arguments.command in ("topic", "service", "node", "param"):
        ending.note_signals()
    try:
        return execute(arguments)
    except (LookupError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    except (KeyboardInterrupt, BrokenPipeError):
        sys.stderr.close()
        return 0

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


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and of what is not here who has it."""

    def error(self, message: str) -> NoReturn:
        more = "; a whole ROS 2 has more" if "invalid choice" in message else ""
        self.exit(2, f"{self.prog}: {message}{more}; see --help\n")


def parser() -> argparse.ArgumentParser:
    """The command line; names and meaning as in ros2cli."""
    root = Parser(prog="ros2", description="A small part of the ros2 command.")
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
    echo = topic.add_parser("echo", help="print messages as YAML")
    echo.add_argument("topic")
    echo.add_argument("--once", action="store_true", help="end after the first message")
    echo.add_argument("--full-length", "-f", action="store_true", help="print arrays in full")
    hz = topic.add_parser("hz", help="print the rate at which messages come")
    hz.add_argument("topic")
    hz.add_argument("--window", "-w", type=int, default=10000, help="messages the rate is computed over")

    service = commands.add_parser("service", help="what can be asked").add_subparsers(dest="verb", required=True)
    names = service.add_parser("list", help="names of the services")
    names.add_argument("-t", "--show-types", action="store_true")
    call = service.add_parser("call", help="call a service and print its response")
    call.add_argument("service")
    call.add_argument("type", help="for example std_srvs/srv/Trigger")
    call.add_argument("values", nargs="?", default="{}", help="fields of the request as YAML")

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
    from ros2_lite import service, topic

    if arguments.command == "service":
        if arguments.verb == "list":
            return service.list_services(arguments.show_types)
        return service.call(arguments.service, arguments.type, arguments.values)
    if arguments.verb == "list":
        return topic.list_topics(arguments.show_types)
    if arguments.verb == "echo":
        return topic.echo(arguments.topic, arguments.once, arguments.full_length)
    return topic.hz(arguments.topic, arguments.window)


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
    if arguments.command in ("topic", "service"):
        ending.note_signals()
    try:
        return execute(arguments)
    except (LookupError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    except (KeyboardInterrupt, BrokenPipeError):
        sys.stderr.close()
        return 0

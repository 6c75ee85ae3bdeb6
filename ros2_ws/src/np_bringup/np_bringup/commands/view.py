"""`view [BAG]`: a web page that shows arm, object, goal and camera, of a bag or of the graph that is running."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from functools import partial

from np_common.cli import Parser
from np_description.domains import DOMAINS, Task
from np_description.objects.choice import DEFAULT, domain_with, read_domain


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="view", description=__doc__.partition(": ")[2])
    p.add_argument("bag", nargs="?", help="bag to play; without one, the graph in this ROS_DOMAIN_ID")
    p.add_argument("--domain", choices=list(DOMAINS), default="card", help="what a running graph works on; %(default)s")
    p.add_argument("--object", default=DEFAULT, help="and what with: a row of its table, or a .yaml file; %(default)s")
    other = p.add_mutually_exclusive_group()
    other.add_argument("--window", action="store_true", help="MuJoCo's viewer on this display instead of a page")
    other.add_argument("--foxglove", action="store_true", help="a WebSocket for the Foxglove app instead of a page")
    p.add_argument(
        "--shapes", action="store_true", help="the arm as the shapes that collide, also where `make meshes` was here"
    )
    p.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to serve at; at 0.0.0.0 who has the printed address may look; %(default)s",
    )
    p.add_argument("--port", type=int, help="0: any that is free; 8300, for Foxglove 8765")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the executable `view`; serves until Ctrl-C."""
    options = parser().parse_args(arguments)
    from np_common.cli import interrupt_on_sigterm

    interrupt_on_sigterm()
    if options.port is None:
        options.port = 8765 if options.foxglove else 8300
    try:
        meshes = False if options.shapes else None
        return _play(options, meshes) if options.bag else _watch(options, meshes)
    except KeyboardInterrupt:
        return 0
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        print("view: --foxglove: expected foxglove-sdk, which `make foxglove` installs", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:  # a BagError is one
        print(f"view: {error}", file=sys.stderr)
        return 1


def _play(options: argparse.Namespace, meshes: bool | None) -> int:
    import threading

    if options.window:
        from np_bringup.view.window import Window, play
        from np_record.bag import Recording

        with Recording(options.bag, required=("joint_states",)) as recording:
            play(recording, read_domain(recording.information), partial(Window, meshes=meshes))
        return 0
    if options.foxglove:
        from np_bringup.view.foxglove_stream import play
        from np_record.bag import Recording

        with Recording(options.bag) as recording:
            play(recording, _foxglove(options, read_domain(recording.information)))
        threading.Event().wait()
    from np_bringup.view.recorded import RecordedEpisode
    from np_bringup.view.server import serve

    _tell(serve(RecordedEpisode(options.bag, meshes=meshes), options.host, options.port))
    threading.Event().wait()
    return 0


def _watch(options: argparse.Namespace, meshes: bool | None) -> int:
    from np_bringup.view.live import LiveGraph
    from np_bringup.view.server import serve
    from np_ros.client.graph_client import GraphClient
    from np_ros.processes.domain import ros_domain_id

    ros_domain_id()  # raises ValueError where it is not usable
    with closing(GraphClient("view")) as peer:
        domain = domain_with(options.domain, options.object)
        if options.foxglove:
            from np_bringup.view.foxglove_stream import listen

            listen(peer, _foxglove(options, domain))
            while True:
                peer.spin_once(0.2)
        if options.window:
            from np_bringup.view.window import Window

            with closing(Window(domain, meshes=meshes)) as window:
                live = LiveGraph(peer, domain)
                while window.is_open:
                    peer.idle_for(0.05)
                    if (moment := live.moment()) is not None:
                        window.show(moment)
            return 0
        live = LiveGraph(peer, domain, meshes=meshes)
        _tell(serve(live, options.host, options.port))
        while True:
            peer.spin_once(0.2)


def _foxglove(options: argparse.Namespace, domain: Task):
    """The stream of a server that runs until the process ends."""
    import foxglove

    from np_bringup.view.foxglove_stream import FoxgloveStream

    context = foxglove.Context()
    server = foxglove.start_server(name="np", host=options.host, port=options.port, context=context)
    print(f"ws://{options.host}:{server.port}   in Foxglove: Open connection; Ctrl-C ends it", flush=True)
    return FoxgloveStream(domain, context)


def _tell(server) -> None:
    print(f"{server.address}   Ctrl-C ends it", flush=True)


if __name__ == "__main__":
    raise SystemExit(main())

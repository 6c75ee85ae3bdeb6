"""`check_backend`: the contract suite, put to a backend that is running; one line a check, JSON last."""

from __future__ import annotations

import argparse
import json
import sys
import time
from contextlib import closing

from np_common.cli import Parser

MODES = ("realtime", "lockstep")
WARNING = (
    "The arm will move: joint 7 by up to a tenth of a radian, the fingers by 2 cm. Commands are sent that a backend has to refuse "
    "(torques and speeds over their limits among them); one that does not will carry them out. On a real arm: free space, user stop in hand."
)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="check_backend", description=f"{__doc__.partition(': ')[2]} {WARNING}")
    p.add_argument("node", help="name of the backend's node, as in its diagnostics")
    p.add_argument("--mode", choices=MODES, default="realtime", help="in which it runs; %(default)s")
    p.add_argument("--limit", type=float, default=20.0, help="how long to wait for what is due, s; %(default)g")
    return p


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `check_backend`; 0 where every check was kept, 1 where one was not, 2 where none could be put."""
    options = parser().parse_args(args)
    from np_evaluation.conformance.judging import CheckResult, NotTestable, judge
    from np_ros.client.graph_client import GraphClient

    def tell(verdict: CheckResult) -> None:
        took = f" ({verdict.seconds:.1f} s)" if verdict.was_asked else ""
        print(f"{verdict.mark:5} {verdict.check.words}{took}{f': {verdict.text}' if verdict.text else ''}", flush=True)

    print(WARNING, file=sys.stderr)
    began = time.monotonic()
    with closing(GraphClient("check_backend", limit=options.limit)) as peer:
        try:
            verdicts = judge(peer, options.node, options.mode, tell)
        except NotTestable as error:
            print(f"check_backend: {error}", file=sys.stderr)
            return 2
    failed = [v.check.words for v in verdicts if v.was_asked and v.text]
    print(
        json.dumps(
            {
                "backend": options.node,
                "mode": options.mode,
                "kept": sum(v.was_asked and not v.text for v in verdicts),
                "broken": failed,
                "not_asked": [v.check.words for v in verdicts if not v.was_asked],
                "seconds": round(time.monotonic() - began, 1),
            }
        )
    )
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())

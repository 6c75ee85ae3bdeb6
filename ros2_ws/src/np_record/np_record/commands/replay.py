"""`replay BAG`: feed a lockstep recording to the nodes; compare their actions with it, bit by bit."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm
from np_ros.processes.supervisor import NodeDied, Supervisor


def replay(bag: Path, weights: str, logs: Path) -> dict[str, object]:
    """Counts by topic and the first difference. Raises BagError, NodeDied, TimeoutError, LookupError."""
    from np_record.bag import Recording  # slow, as are the others
    from np_record.nodes.player_node import Player
    from np_record.replay import REQUIRED, ReplayScript

    began = time.monotonic()
    with Recording(bag, REQUIRED) as recording:
        script = ReplayScript(recording, weights)
        with Supervisor(logs) as supervisor:
            supervisor.start(script.specs)
            with Player(supervisor, script) as player:
                player.wait_until_ready({spec.name for spec in script.specs})
                progress = Progress(script.length, f"replay {bag.name}")
                for number, step in enumerate(script.steps()):
                    if not player.play(step):
                        break
                    if number % 500 == 0:
                        progress.show(number)
                player.finish(recording.end)
                progress.show(script.length)
                comparison = player.comparison
    topics = {
        name: {
            "expected": comparison.expected[name],
            "received": comparison.received[name],
            "identical": comparison.identical[name],
        }
        for name in script.live
    }
    return {
        "identical": comparison.is_identical,
        "topics": topics,
        "first_mismatch": asdict(comparison.first) if comparison.first else None,
        "bag": str(bag),
        "wall_s": round(time.monotonic() - began, 1),
    }


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 0 only if every action was identical."""
    parser = Parser(prog="replay", description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--weights", default="", help="folder with weights; default: those of the recording")
    options = parser.parse_args(arguments)
    interrupt_on_sigterm()
    try:
        with tempfile.TemporaryDirectory(prefix="replay_") as logs:
            result = replay(options.bag, options.weights, Path(logs))
    except KeyboardInterrupt:
        return INTERRUPTED
    except (NodeDied, TimeoutError, LookupError, ValueError, OSError) as error:  # a BagError is a ValueError
        print(f"replay: {error}", file=sys.stderr)
        return 1
    print(json.dumps(result))
    return 0 if result["identical"] else 1


if __name__ == "__main__":
    raise SystemExit(main())

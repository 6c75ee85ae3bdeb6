"""Both engines beside one another and rigid theory: the static bench with MuJoCo soft, MuJoCo hard and PhysX.

    python -m np_physx_bridge.static_bench [--out FILE]

The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
from datetime import date
from functools import partial
from pathlib import Path

from np_description.contact.model import CONTACTS, HARD
from np_description.mujoco_engine import MujocoEngine
from np_physx_bridge.box_world import PhysxBoxWorld
from np_physx_bridge.engine import PhysxEngine
from np_physx_bridge.library import missing
from np_sim_bridge import static_bench as bench


def results() -> dict[str, dict]:
    """Results by engine; PhysX only where it is installed."""
    found = {
        f"MuJoCo {name}": bench.bench(bench.mujoco(contact), partial(MujocoEngine, contact=contact), contact.table)
        for name, contact in sorted(CONTACTS.items(), reverse=True)
    }
    if not missing():
        found["PhysX"] = bench.bench(partial(PhysxBoxWorld, contact=HARD), PhysxEngine, HARD.table)
    return found


def figures(answers: dict[str, dict]) -> dict[str, dict[str, float | str]]:
    """The summary of figures as `results` returns them, rigid theory first."""
    return {"rigid theory": bench.THEORY, **{name: bench.figures(answer) for name, answer in answers.items()}}


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, help="file to write the same to")
    out = parser.parse_args(arguments).out
    if missing():
        parser.error(missing())
    answers = results()
    whole = {
        "date": date.today().isoformat(),
        "command": "make physx && python -m np_physx_bridge.static_bench",
        "machine": f"{os.cpu_count()} cores, no GPU",
        "figures": figures(answers),
        "answers": answers,
    }
    if out:
        out.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(whole))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Judge the wiring stage.

    python -m np_blind.wiring --episodes BAG... --out FILE

Clean recordings: arms of the sealed test's generator with faults of the catalogue and unknown ones, and the bags that are named. Each of the 24
kinds is put into one of them, twice.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from sim2real.arm.model import panda
from sim2real.excitation.suite import make_suite
from sim2real.recordings.reading import load_log
from sim2real.recordings.signals import Commands, Log
from sim2real.wiring.check import find_stream_fault, find_wiring_fault, read_wiring
from sim2real.wiring.fault import WiringFault

from np_blind.arm.loop import make_targets, run_stable_arms
from np_blind.arm.sampling.cases import draw_cases, make_physics
from np_blind.wiring.faults import KINDS, Subject
from np_common.cli import Parser, Progress
from np_control.impedance import damping
from np_control.safety import LIMITS

EXPERIMENTS = ("chirp_odd", "chirp_even")
REPEATS = 2


def record_arms(count: int, seed: int) -> Iterator[Subject]:
    """Recordings of arms of the sealed test: each with what every real arm has, and a fault, two, none or an unknown one."""
    targets = make_targets(make_suite(EXPERIMENTS))
    cases = draw_cases(count, seed, "development")
    run, staying, _ = run_stable_arms(make_physics(cases)[0], targets, [case.noise for case in cases])
    time_s = LIMITS.period * np.arange(len(targets))
    stiffness, ratio = targets.gains.transpose(1, 0, 2)
    for row, arm in enumerate(staying):
        commands = Commands(
            np.arange(len(targets)),
            *(values[:, row] for values in (run.target, run.target_velocity, run.command)),
            time_s + LIMITS.period / 2,
            stiffness,
            damping(stiffness, ratio),
        )
        measured = (values[:, row] for values in (run.position, run.velocity, run.effort))
        yield Subject(Log(f"arm {arm}", time_s, *measured, time_s - LIMITS.period / 2, False, commands), None)


def read_bags(paths: Sequence[Path]) -> Iterator[Subject]:
    """Bags, those without images with some that are rendered of the object where it begins."""
    for path in paths:
        streams = read_wiring(path)
        if streams.domain is not None and len(streams.poses):
            streams = replace(streams, images=_render(streams.domain, len(path.name)))
        yield Subject(load_log(path), streams)


def _render(domain, seed: int) -> np.ndarray:
    from np_sim_bridge.renderer import make_renderer
    from np_sim_bridge.simulation import Simulation

    images = []
    for number in range(3):
        simulation = Simulation(domain, seed=seed + number)
        renderer = make_renderer("auto", simulation.model, shadows=False)
        images.append(renderer.render(simulation.configuration()))
        renderer.close()
    return np.array(images)


def check(subject: Subject) -> tuple[WiringFault | None, float]:
    """What the stage finds, and s of CPU time that it takes."""
    began = time.process_time()
    fault = find_wiring_fault(subject.log, panda())
    if fault is None and subject.streams is not None:
        fault = find_stream_fault(subject.streams, subject.log)
    return fault, time.process_time() - began


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="python -m np_blind.wiring", description=__doc__.split("\n")[0])
    parser.add_argument("--arms", type=int, default=80, help="recordings of arms (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=900, help="of everything random (default: %(default)s)")
    parser.add_argument("--episodes", type=Path, nargs="*", default=[], help="bags of pushing episodes without faults")
    parser.add_argument("--bags", type=Path, nargs="*", default=[], help="further bags without faults")
    parser.add_argument("--out", type=Path, help="file for the results")
    options = parser.parse_args(arguments)
    episodes, bags = list(read_bags(options.episodes)), list(read_bags(options.bags))
    arms = list(record_arms(options.arms, options.seed))
    clean = [*episodes, *bags, *arms]
    sources = {"arm": arms, "episode": episodes}
    kinds = [kind for kind in KINDS if sources[kind.source]]
    bar, rows, false, seconds = Progress(len(clean) + REPEATS * len(kinds), "wiring"), [], [], []
    for number, subject in enumerate(clean):
        fault, took = check(subject)
        seconds.append(took)
        if fault is not None:
            false.append({"recording": subject.log.name, "sentence": fault.sentence})
        bar.show(number + 1)
    for number, kind in enumerate(kinds):
        found = []
        for repeat in range(REPEATS):
            rng = np.random.default_rng([options.seed, number, repeat])
            subjects = sources[kind.source]
            fault, took = check(kind.apply(subjects[int(rng.integers(len(subjects)))], rng))
            seconds.append(took)
            joints = tuple(panda().joints[j] for j in kind.joints)
            is_right = fault is not None and (fault.kind, fault.joints) == (kind.expected, joints)
            found.append({"right": is_right, "sentence": fault.sentence if fault else ""})
        rows.append({"kind": kind.name, "found": found})
        bar.show(len(clean) + REPEATS * (number + 1))
    figures = {
        "kinds_found": sum(all(one["right"] for one in row["found"]) for row in rows),
        "kinds": len(rows),
        "cases_found": sum(one["right"] for row in rows for one in row["found"]),
        "cases": REPEATS * len(rows),
        "false_alarms": len(false),
        "clean": len(clean),
        "cpu_s_median": round(float(np.median(seconds)), 2),
        "cpu_s_most": round(max(seconds), 2),
    }
    if options.out:
        options.out.write_text(json.dumps({"figures": figures, "kinds": rows, "false": false}, indent=1) + "\n")
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())

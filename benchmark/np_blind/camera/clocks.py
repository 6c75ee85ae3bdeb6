"""How well the doctor tells two clocks: streams from joints that move, and others' recordings whose stamps are shifted.

`python -m np_blind.camera.clocks --real streams.npz --draws 200 --seed 0 --out docs/results/chain_clock.json`. The last line printed
is one JSON object.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from np_common.cli import Parser, Progress

if TYPE_CHECKING:  # slow: no --help should wait for it
    from sim2real.task.clock import Clock
    from sim2real.task.streams import Stream

    from np_blind.camera.pose_streams import Rig

SHIFTS = (-0.08, -0.06, -0.04, -0.02, 0.02, 0.04, 0.06, 0.08)  # s
DRIFTS = (0.0, 50.0, 100.0, 200.0)  # ppm
OFFSETS = (-0.2, 0.3)  # s
SHORT = 20.0  # s
PAIRS = {
    "real arm, infrared camera": (
        "robot_arm/robot_arm_complete_bag_color_and_ir_base_link_sr300_hinge",
        "robot_arm/robot_arm_complete_bag_color_and_ir_target_ir",
    ),
    "motion capture, PrimeSense": (
        "prime_sense_1/2017-04-09-18-13-10_vicon_prime_sense",
        "prime_sense_1/2017-04-09-18-13-10_W_camera_rgb_image_raw",
    ),
    "simulated arm": (
        "robot_arm_w_color_camera_sim/robot_arm_sim_hand",
        "robot_arm_w_color_camera_sim/robot_arm_sim_camera",
    ),
}
"""Arrays of the published streams (ETH Zurich ASL, hand_eye_calibration): what counts, and the camera."""
RIGS = {
    "lively": {},
    "slow and noisy": {"reach": 0.06, "angle": 0.01},
    "slow, correlated noise": {"reach": 0.1, "angle": 0.008, "memory": 0.9},
    "slow, error of a lens": {"reach": 0.1, "bend": 0.01},
}
"""What the synthetic recordings are like, as changes of `Rig`."""


def _short(stream: Stream, rng: np.random.Generator) -> Stream:
    begin = stream.time[0] + rng.uniform(0, max(stream.duration - SHORT, 0.0))
    return stream.rows((stream.time >= begin) & (stream.time < begin + SHORT))


def _lossy(stream: Stream, rng: np.random.Generator) -> Stream:
    return stream.rows(rng.random(len(stream.time)) >= 0.2)


CONDITIONS: dict[str, Callable[[Stream, np.random.Generator], Stream]] = {
    "all frames": lambda stream, rng: stream,
    "odd frames, baseline from even ones": lambda stream, rng: stream.rows(np.arange(1, len(stream.time), 2)),
    "half the rate": lambda stream, rng: stream.rows(np.arange(0, len(stream.time), 2)),
    "a fifth of the frames lost": _lossy,
    "20 s": _short,
    "20 s, half the rate, a fifth lost": lambda stream, rng: _short(
        _lossy(stream.rows(np.arange(0, len(stream.time), 2)), rng), rng
    ),
}
"""What is left of the camera's frames."""


def half_width(clock: Clock) -> float:
    """s, half the width of an offset's interval."""
    return (clock.offset.high - clock.offset.low) / 2


def shifted(path: Path, rng: np.random.Generator, tell: Callable[[str], None]) -> Iterator[dict]:
    """A row for each recording, condition and shift: what is recovered of the shift."""
    from sim2real.task.clock import compare
    from sim2real.task.streams import read

    for recording, names in PAIRS.items():
        a, b = (read(f"{path}:{name}") for name in names)
        baseline = {"all": compare(a, b), "even": compare(a, b.rows(np.arange(0, len(b.time), 2)))}
        whole = baseline["all"]
        yield {"recording": recording, "condition": "as it is", "shift_s": 0.0} | _row(whole)
        for condition, left in CONDITIONS.items():
            base = baseline["even" if condition.startswith("odd") else "all"]
            for shift in SHIFTS:
                tell(f"{recording}, {condition}")
                found = compare(a, left(b, rng).shifted(shift))
                row = {"recording": recording, "condition": condition, "shift_s": shift} | _row(found)
                if found.offset and base.offset:
                    error = found.offset.value - base.offset.value - shift
                    row["error_s"] = error
                    row["holds"] = bool(abs(error) <= np.hypot(half_width(found), half_width(base)))
                yield row


def _row(clock: Clock) -> dict:
    row = {"verdict": clock.verdict, "doubt": clock.doubt}
    if clock.offset:
        row |= {"offset_s": clock.offset.value, "half_width_s": half_width(clock), "drift_ppm": clock.drift.value}
        row["drift_half_width_ppm"] = (clock.drift.high - clock.drift.low) / 2
    return row


def drawn(draws: int, seed: int, tell: Callable[[str], None], base: Rig | None = None) -> Iterator[dict]:
    """A row for each synthetic recording: what was true, and what was found. base: what they are changes of, None: `Rig()`."""
    from sim2real.task.clock import compare

    from np_blind.camera.pose_streams import Rig, record

    base = base or Rig()
    for number in range(draws):
        rng = np.random.default_rng([seed, number])
        name = list(RIGS)[number % len(RIGS)]
        tell(f"synthetic, {name}")
        rig = replace(base, offset=rng.uniform(*OFFSETS), drift=float(rng.choice(DRIFTS)), **RIGS[name])
        clock = compare(*record(rig, rng))
        row = {"rig": name, "drift_ppm": rig.drift, "verdict": clock.verdict, "doubt": clock.doubt}
        if clock.offset:
            true = rig.offset + 1e-6 * rig.drift * (clock.middle - rig.duration / 2)
            row |= {
                "error_s": clock.offset.value - true,
                "half_width_s": half_width(clock),
                "holds": clock.offset.holds(true),
                "drift_error_ppm": clock.drift.value - rig.drift,
                "drift_half_width_ppm": (clock.drift.high - clock.drift.low) / 2,
                "drift_holds": clock.drift.holds(rig.drift),
                "drift_named": "clock_offset" in clock.effects and clock.verdict == "identified",
            }
        yield row


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(prog="python -m np_blind.camera.clocks", description=__doc__.split("\n")[0])
    parser.add_argument("--real", type=Path, help="the published streams.npz (default: synthetic recordings only)")
    parser.add_argument("--draws", type=int, default=200, help="synthetic recordings (default 200)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file for the JSON")
    options = parser.parse_args(arguments)
    if options.real and not options.real.exists():
        parser.error(f"--real: expected a file, got {options.real}")
    total = options.draws + (len(PAIRS) * len(CONDITIONS) * len(SHIFTS) if options.real else 0)
    progress, done = Progress(max(total, 1), "clocks"), iter(range(total))
    command = f"python -m np_blind.camera.clocks {'--real streams.npz ' if options.real else ''}--draws {options.draws}"

    def tell(what: str) -> None:
        progress.show(next(done), what)

    synthetic = list(drawn(options.draws, options.seed, tell))
    real = list(shifted(options.real, np.random.default_rng(options.seed), tell)) if options.real else []
    progress.show(total, "done")
    found = {
        "date": time.strftime("%Y-%m-%d"),
        "command": f"{command} --seed {options.seed} --out docs/results/chain_clock.json",
        "seed": options.seed,
        "synthetic": synthetic,
        "real": real,
    }
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    told = [row for row in synthetic if "holds" in row]
    kept = [row for row in real if "holds" in row]
    print(
        json.dumps(
            {
                "coverage95": _mean(told, "holds"),
                "drift_coverage95": _mean(told, "drift_holds"),
                "undetermined": len(synthetic) - len(told),
                "real_within_5_ms": float(np.mean([abs(row["error_s"]) < 5e-3 for row in kept])) if kept else None,
                "real_coverage95": _mean(kept, "holds"),
                "real_undetermined": sum(row["verdict"] == "undetermined" for row in real),
            }
        )
    )
    return 0


def _mean(rows: list[dict], key: str) -> float | None:
    return float(np.mean([row[key] for row in rows])) if rows else None


if __name__ == "__main__":
    raise SystemExit(main())

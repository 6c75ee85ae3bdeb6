"""docs/results/driver.md: what the hardware driver did, from the JSON files of `make driver-report`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

HEAD = """<!-- Written by `make docs` from driver_*.json: do not edit. -->
# What the driver did

Measured by `make driver-report`, against a simulated FR3 on the robot's own network protocol, its clock
included; what that leaves open is in [hardware.md](../guide/hardware.md#what-is-not-tested). Robot, driver,
controller and the report itself are Python processes that share the cores named below. "Load" is the
load average of the last minute before a row was measured, by whatever else ran; "stolen" the share of
the cores' time that the host of this virtual machine gave to others meanwhile.
"""
TEXTS = {
    "tracking": """## Impedance tracking

Two waves a joint, 0.1 to 0.4 Hz, gains of the controller itself (400 and 100 Nm/rad, damping ratio 1).
The error is between the joint target of a state and the joints as the robot knows them at that state.
Cycles are the driver's, from one state read to the next; lost are those that it missed, "no command"
those in which the robot, by its own account, had none. The robot's longest cycle is the simulator's own
delay, which no robot has, and which the driver's cannot be shorter than. It spends .3 to .4 ms of each
cycle on itself, and counts an answer that comes after the rest as none: on board, where the whole law runs
between a state and its answer, that is often short; the torque then holds for another millisecond. Robot,
driver and controller ran at real-time priority where that is permitted; what else ran delays them all the
same: the kernel gives a core's ordinary tasks 50 ms at a time where real-time ones have left them nothing,
which are the longest cycles. Time that the host has stolen delays whoever comes first.
""",
    "approach": """## The approach of a card episode

The nodes `episode`, `pre_contact` and `approach` with their released weights and RRT*, keypoints of a
card that stands still, then `joint_impedance` (topic) or the controller on board. The hand's error is
that from the pre-contact pose, at rest after the motion; there is no table and no card behind the
protocol.
""",
    "suite": """## The diagnosis suite

`excite --backend running --mode realtime` beside driver and controller, as beside any backend, then
`diagnose --quick` on the bag: its contract passes. Lost are messages for which the recorder had no time.
The verdict is on the simulated arm: another model, without friction, than the nominal one, and says nothing
of a real one.
""",
    "faults": """## Faults over the wire

Each fault is injected into a fast motion: all joints on a trajectory, or the last joint turned by
commands that keep coming. The figures are the robot's own record, each millisecond, from the fault until
rest: the largest speed and commanded torque as shares of the joint's limit, the largest change of torque
from one command to the next (1 Nm is the limit), the time until every joint is slower than 0.05 rad/s,
and who braked: the driver, or the robot, which nobody commanded any more. The robot's own brake is the
simulated one's. The robot's clock goes at a third of its speed here, so that a busy machine changes
nothing.
""",
}
CYCLES = {
    "cycle_rate_hz": "cycles/s",
    "cycle_p50_ms": "p50, ms",
    "cycle_p99_ms": "p99, ms",
    "cycle_max_ms": "max, ms",
    "lost_cycles": "lost",
    "unanswered_per_1000": "no command, of 1,000",
    "robot_pause_ms": "robot's longest cycle, ms",
}
COLUMNS: dict[str, dict[str, str]] = {
    "tracking": {
        "control": "control",
        "load_before": "load",
        "stolen": "stolen",
        "seconds": "s",
        **CYCLES,
        "commands_per_1000": "answers in 1,000",
        "joint_rms_rad": "joints rms, rad",
        "joint_max_rad": "max, rad",
        "hand_rms_mm": "hand rms, mm",
        "hand_max_mm": "max, mm",
        "state": "state at the end",
    },
    "approach": {
        "control": "control",
        "load_before": "load",
        "stolen": "stolen",
        "plan_s": "motion, s",
        "plan_points": "points",
        "end_joint_error_rad": "end, joints, rad",
        "end_hand_error_mm": "end, hand, mm",
        "end_hand_error_deg": "end, hand, deg",
        "hand_rms_mm": "on the way rms, mm",
        "hand_max_mm": "max, mm",
        **CYCLES,
    },
    "suite": {
        "control": "control",
        "load_before": "load",
        "experiments": "experiments",
        "messages": "messages",
        "lost": "lost",
        "verdict": "verdict",
        "diagnose_s": "diagnose, s",
    },
    "faults": {
        "fault": "fault",
        "control": "control",
        "state": "state",
        "cause": "cause",
        "peak_speed_share": "speed",
        "peak_torque_share": "torque",
        "peak_torque_step": "step, Nm",
        "time_to_rest": "to rest, s",
        "braked_by": "braked by",
        "after": "after recovery",
    },
}


def page(folder: Path, parts: Sequence[str]) -> str:
    """The page, from the JSON files of those parts that have been measured."""
    sections = [HEAD]
    for part in parts:
        path = folder / f"driver_{part}.json"
        if path.exists():
            measured = json.loads(path.read_text())
            origin = f"{measured['date']}, {measured['machine']} ([data](driver_{part}.json)).\n"
            if part != "faults" and measured["pace"] != 1:
                origin += f"\n**The robot's clock went at 1/{measured['pace']:g} of its speed, "
                origin += "on a busy machine: the cycle times are that machine's.**\n"
            sections += [TEXTS[part], origin, table(measured["rows"], COLUMNS[part])]
            if part == "tracking":
                sections += [costs(measured["rows"])]
    return "\n".join(sections)


def table(rows: list[dict], columns: dict[str, str]) -> str:
    """One table, a row each."""
    lines = ["| " + " | ".join(columns.values()) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(str(row[key]).replace("|", "/") for key in columns) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def costs(rows: list[dict]) -> str:
    """What each process took of a core in each mode: its first thread, and the others."""
    names = list(dict.fromkeys(name for row in rows for name in row["shares"]))
    listed = [
        {"share of a core": name, **{row["control"]: row["shares"].get(name, "") for row in rows}} for name in names
    ]
    return "What it cost; other threads are the middleware's:\n\n" + table(listed, {key: key for key in listed[0]})

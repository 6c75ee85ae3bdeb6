"""docs/results/driver.md: measurements of the hardware driver, from the data of `make driver-report`."""

from __future__ import annotations

import json
from pathlib import Path

HEAD = """<!-- Written by `make docs` from driver.json: do not edit. -->
# Hardware driver against a simulated FR3

`make driver-report` measures the driver against a simulated FR3 on the robot's own network protocol. No real arm was used;
[hardware.md](../guide/hardware.md#what-is-not-tested) lists what that leaves open. Robot, driver, controller and report are Python
processes that share the cores named below. "Load" is the load average of the minute before a row. "Stolen" is the share of the
cores' time that the host gave to other virtual machines.
"""
TEXTS = {
    "tracking": """## Impedance tracking

Each joint follows two waves of 0.1 to 0.4 Hz with gains of 400 and 100 Nm/rad and damping ratio 1. The error is between a state's
joint target and the joints at that state. A cycle lasts from one state to the next. "Lost" counts cycles that the driver missed,
"no command" those in which the robot had none. The robot's longest cycle is the simulator's own delay.
The simulated robot ignores a command that arrives in the last 0.3 to 0.4 ms of a cycle. On board, where the whole law runs between a
state and its command, commands are often that late; the torque then holds for another millisecond.
A real robot stops after 20 lost cycles in a row.
""",
    "approach": """## The approach of a card episode

`episode`, `pre_contact` and `approach` run with released weights and keypoints of a card at rest. Then `joint_impedance` (topic) or
the controller on board executes the motion. The hand's error is measured against the pre-contact pose after the motion.
The simulated robot has no table and no card.
""",
    "suite": """## The diagnosis suite

`excite --backend running --mode realtime` runs beside driver and controller, then `diagnose --quick` reads the bag. Its contract
passes. "Lost" counts messages that the recorder dropped. The verdict concerns the simulated arm, whose model differs from the nominal one.
""",
    "faults": """## Faults over the wire

Each fault is injected into a fast motion. The figures are the robot's own record, each millisecond, from the fault until rest: largest
speed and commanded torque as shares of the joint's limit, largest change of torque between two commands (limit 1 Nm), time until
every joint is slower than 0.05 rad/s, and whether the driver or the robot braked. The robot's clock runs at a third of its speed.
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
        "commands_per_1000": "commands in 1,000",
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


def page(data: Path) -> str:
    """The page, of those parts that `data` holds."""
    sections = [HEAD]
    for part, measured in json.loads(data.read_text()).items():
        origin = f"{measured['date']}, {measured['machine']} ([data]({data.name})).\n"
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
    return "Processor time; other threads belong to the middleware:\n\n" + table(
        listed, {key: key for key in listed[0]}
    )

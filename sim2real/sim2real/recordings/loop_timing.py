"""What breaks the control loop of a recording: lost cycles, late commands and targets, and their likely cause.

A cause is named where its own measurement accounts for the lost time: the time for which a thread waited for a processor (a busy
machine), or worked beyond its period (computation). What neither accounts for did not arrive: the network, or the kernel's share of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim2real.recordings.loop_record import LoopRecord, NodeReports
from sim2real.thresholds import THRESHOLDS

LOOP = THRESHOLDS.control_loop
NONE = np.zeros((0, 2))

BUSY, COMPUTATION, NETWORK, MESSAGES, POLICY, RECORDER, UNDETERMINED = (
    "busy_machine",
    "computation",
    "network",
    "messages",
    "policy",
    "recorder",
    "undetermined",
)
UNKNOWN, LOCKSTEP, STEADY, DISTURBED, BROKEN = "unknown", "lockstep", "steady", "disturbed", "broken"
WAIT, OVERRUN = "processor_wait_ms", "overrun_ms"
ABORTED, SILENT = "communication_constraints_violation", "silence: no command"


@dataclass(frozen=True)
class LoopFault:
    """One way in which the loop was disturbed."""

    what: str
    """"lost_cycles", "low_success", "missed_periods", "late_commands", "late_targets" or "lost_messages"."""
    cause: str
    """"busy_machine", "computation", "network", "messages" (between driver and controller), "policy", "recorder" or "undetermined"."""
    is_broken: bool
    """Whether it is beyond what the robot or the driver tolerates."""
    sentence: str
    """What happened, the cause, and the number that shows it."""


@dataclass(frozen=True, eq=False)
class LoopTiming:
    """The timing of one recording. Numbers are None where they were not recorded."""

    status: str
    """"unknown", "lockstep" (time waits for replies), "steady", "disturbed" or "broken" (beyond what the robot tolerates)."""
    reason: str
    """Why it is unknown; "" otherwise."""
    faults: tuple[LoopFault, ...] = ()
    """The disturbances."""
    lost_cycles: int | None = None
    """Cycles of the robot that the driver did not see."""
    in_a_row: int | None = None
    """Lower bound of the largest number of cycles that were lost in a row, of those that show in the stamps."""
    lost_share: float | None = None
    """Share of all cycles that were lost."""
    success_rate: float | None = None
    """Mean share of commands that the robot reports to have come in time."""
    late_share: float | None = None
    """Share of states without a command, or with one that came too late."""
    dropped_share: float | None = None
    """Share of published commands that the driver did not take."""
    answer_ms: tuple[float, float] | None = None
    """Median and 99th percentile of the time from a state's publication to its command's, ms; medians over the recording."""
    lost: np.ndarray = field(default_factory=NONE.copy)
    """(d, 2) time s of each report and cycles or periods lost since the one before."""
    state_gaps: np.ndarray = field(default_factory=NONE.copy)
    """(g, 2) time s and length ms of steps between stamps of joint states that are longer than a period."""
    command_gaps: np.ndarray = field(default_factory=NONE.copy)
    """(g, 2) the same of commands."""

    @property
    def broken_sentence(self) -> str:
        """For the headline: what is beyond what the robot tolerates; "" where nothing is."""
        broken = [fault.sentence for fault in self.faults if fault.is_broken]
        return f"The control loop broke. {' '.join(broken)}" if broken else ""


NOT_RECORDED = LoopTiming(UNKNOWN, "the file has no diagnostics")
"""The timing of a file without diagnostics."""


def find_loop_timing(record: LoopRecord) -> LoopTiming:
    """The timing of a recording; without diagnostics of driver or simulator it is unknown."""
    if len(record.states) < 3:
        return NOT_RECORDED
    if record.is_lockstep:
        return LoopTiming(LOCKSTEP, "")
    driver, bridge = record.first_with("lost_cycles"), record.first_with("missed_periods")
    period = float(np.median(np.diff(record.states)))
    states, commands = _gaps(record.states, period), _gaps(record.commands, period)
    incomplete, faults, numbers = [], [], {"state_gaps": states, "command_gaps": commands}
    if driver is not None:
        lost = driver.growth("lost_cycles")
        success = _mean_success(driver)
        cycles = max(1, round(float(np.ptp(driver.time)) / LOOP.cycle))
        numbers |= {
            "lost_cycles": int(lost.sum()),
            "lost_share": float(lost.sum() / cycles),
            "in_a_row": _in_a_row(driver, lost, states),
            "success_rate": success,
            "dropped_share": _dropped(record, driver),
            "lost": np.column_stack([driver.time, lost]),
        }
        faults += _lost_cycles(driver, lost, numbers) + _low_success(driver, numbers)
        incomplete = _lost_messages(driver, lost.sum() * LOOP.cycle, record, period)
    elif bridge is not None:
        missed = bridge.growth("missed_periods")
        numbers["lost"] = np.column_stack([bridge.time, missed])
        faults += _missed_periods(bridge, missed, period)
        incomplete = _lost_messages(bridge, 0.0, record, period)  # stamps of a simulator skip nothing
    controller = record.first_with("answer_p99_ms")
    if controller is not None:
        numbers["answer_ms"] = tuple(
            float(np.nanmedian(controller.values[key])) for key in ("answer_p50_ms", "answer_p99_ms")
        )
    if len(record.commands) > 1 and not _is_onboard(driver):
        late, share = _late_commands(record, driver or bridge, controller, period, not incomplete)
        faults += late
        numbers["late_share"] = None if incomplete else share
    faults += _late_targets(record) + incomplete
    if faults:
        return LoopTiming(BROKEN if any(f.is_broken for f in faults) else DISTURBED, "", tuple(faults), **numbers)
    reason = _why_unknown(record, driver or bridge)
    return LoopTiming(UNKNOWN if reason else STEADY, reason, (), **numbers)


def explain_effect(timing: LoopTiming, effect: str, value: float) -> str:
    """A sentence where the loop's own timing accounts for an effect's value (share of lost commands, or delay s); "" elsewhere."""
    if effect == "packet_loss":
        shares = {
            "of the robot's cycles were lost": timing.lost_share,
            "of the published commands did not reach the driver": timing.dropped_share,
            "of the states had no command in time": timing.late_share,
        }
        words, share = max(shares.items(), key=lambda item: item[1] or 0.0)
        if (share or 0.0) >= LOOP.accounted * value:
            return (
                f"Packet loss ({100 * value:.2g} %) is explained by the loop's own timing: {100 * share:.2g} % {words}."
            )
    if effect == "command_delay" and timing.answer_ms is not None:
        median, p99 = timing.answer_ms
        if LOOP.accounted * median <= 1e3 * value <= p99:
            return f"Command delay ({1e3 * value:.2g} ms) is explained by the controller's answers, which take {median:.2g} ms in the median."
    return ""


def _why_unknown(record: LoopRecord, backend: NodeReports | None) -> str:
    if not record.nodes:
        return "the recording has no diagnostics"
    if backend is None:
        return "the diagnostics have no count of lost cycles or missed periods"
    if not len(record.commands):
        return "effort_command was not recorded"
    steps = np.diff(backend.time)
    covered = float(steps[steps <= LOOP.settled].sum())
    if covered < LOOP.covered * record.states[-1]:
        return f"diagnostics cover only {covered:.0f} of {record.states[-1]:.0f} s"
    return ""


def _gaps(stamps: np.ndarray, period: float) -> np.ndarray:
    """(g, 2) begin s and length ms of steps of more than a period and a half."""
    steps = np.diff(stamps)
    long = steps > 1.5 * period
    return np.column_stack([stamps[:-1][long], 1e3 * steps[long]])


def _is_onboard(driver: NodeReports | None) -> bool:
    return driver is not None and any("control: onboard" in text for text in driver.words)


def _is_new(node: NodeReports, text: str) -> bool:
    """Whether a text came up within the recording: the last error stays in the diagnostics."""
    return text not in node.words[0] and any(text in words for words in node.words)


def _mean_success(driver: NodeReports) -> float | None:
    """The robot reports 0 while it is not controlled."""
    rate = driver.values.get("command_success_rate", np.zeros(0))
    rate = rate[rate > 0]
    return float(rate.mean()) if rate.size else None


def _counted_after(node: NodeReports, counted: np.ndarray, time: float) -> float:
    """How much of a count (d,) a loss at some time can have added."""
    return float(counted[(node.time > time) & (node.time <= time + LOOP.settled)].sum())


def _in_a_row(driver: NodeReports, lost: np.ndarray, gaps: np.ndarray) -> int:
    """Stamps are of whole periods of two cycles: a step of g cycles has lost g - 2 of them or one more."""
    found = 0
    for time, length in gaps:
        count = round(1e-3 * length / LOOP.cycle) - 2
        if count <= _counted_after(driver, lost, time):
            found = max(found, count)
    return found


def _dropped(record: LoopRecord, driver: NodeReports) -> float | None:
    """By counts between the first report and the last."""
    if _is_onboard(driver) or not driver.has("commands") or len(driver.time) < 2:
        return None
    sent = int(((record.commands > driver.time[0]) & (record.commands <= driver.time[-1])).sum())
    return max(0.0, 1.0 - float(driver.growth("commands").sum()) / sent) if sent else None


@dataclass(frozen=True)
class _Evidence:
    """What was measured in the seconds in which something was lost."""

    cause: str
    lost: float
    """ms."""
    waited: float
    """ms for a processor, beyond what is usual in seconds without a loss."""
    worked: float
    """ms of work beyond the period."""


def _attribute(node: NodeReports | None, lost: np.ndarray, worked: np.ndarray | None, otherwise: str) -> _Evidence:
    """The cause of most of the lost time (d,) ms by report. worked: (d,) ms of work beyond the period; None where it is not known."""
    if node is None or worked is None or not node.has(WAIT):
        return _Evidence(UNDETERMINED, float(lost.sum()), 0.0, 0.0)
    waited, rows = node.growth(WAIT), lost > 0
    # A count of the driver is up to a second older than the wait beside it.
    near = np.array([rows[(node.time >= t) & (node.time <= t + LOOP.settled)].any() for t in node.time])
    waited = np.maximum(waited - (np.median(waited[~near]) if (~near).any() else 0.0), 0.0)
    by_cause = dict.fromkeys((BUSY, COMPUTATION, otherwise), 0.0)
    for i in np.flatnonzero(rows):
        window = (node.time <= node.time[i]) & (node.time >= node.time[i] - LOOP.settled)
        if waited[window].sum() >= LOOP.accounted * lost[i]:
            by_cause[BUSY] += lost[i]
        elif worked[i] >= LOOP.accounted * lost[i]:
            by_cause[COMPUTATION] += lost[i]
        else:
            by_cause[otherwise] += lost[i]
    cause = max(by_cause, key=by_cause.get)
    return _Evidence(cause, float(lost.sum()), float(waited[near].sum()), float(worked[rows].sum()))


def _lost_cycles(driver: NodeReports, lost: np.ndarray, numbers: dict) -> list[LoopFault]:
    count, share, row = numbers["lost_cycles"], numbers["lost_share"], numbers["in_a_row"]
    aborted, success = _is_new(driver, ABORTED), numbers["success_rate"]
    if not aborted and share < LOOP.lost and row < LOOP.burst:
        return []
    worked = driver.growth(OVERRUN) if driver.has(OVERRUN) else None
    evidence = _attribute(driver, 1e3 * LOOP.cycle * lost, worked, NETWORK)
    low = success is not None and success < LOOP.success and share >= LOOP.accounted * (1 - success)
    words = f"The driver lost {count} cycles ({100 * share:.2g} %), up to {max(row, 1)} in a row"
    words += ", and the robot ended the motion." if aborted else f"; the robot ends a motion after {LOOP.in_a_row}."
    if low:
        words += f" Only {100 * success:.1f} % of the commands came in time."
    return [
        LoopFault("lost_cycles", evidence.cause, aborted or low or row >= LOOP.in_a_row, f"{words} {_why(evidence)}")
    ]


def _why(evidence: _Evidence) -> str:
    """The cause of cycles that the driver lost, with the numbers that show it."""
    seconds = f"In the seconds in which it lost {evidence.lost:.0f} ms"
    waited, worked = f"waited {evidence.waited:.0f} ms for a processor", f"worked {evidence.worked:.0f} ms too long"
    return {
        BUSY: f"Likely cause: a busy machine. {seconds} it {waited}.",
        COMPUTATION: f"Likely cause: the driver's own computation. {seconds} it {worked}.",
        NETWORK: f"Likely cause: network or kernel. {seconds} it only {waited} and {worked}.",
        UNDETERMINED: f"The cause is not recorded: the driver's diagnostics lack {OVERRUN} or {WAIT}.",
    }[evidence.cause]


def _low_success(driver: NodeReports, numbers: dict) -> list[LoopFault]:
    """Commands that the robot did not get in time, though the driver has seen most of its cycles."""
    success = numbers["success_rate"]
    if success is None or success >= LOOP.success or numbers["lost_share"] >= LOOP.accounted * (1 - success):
        return []
    words = (
        f"Only {100 * success:.1f} % of the commands reached the robot in time; {100 * LOOP.success:.0f} % are needed."
    )
    if not driver.has("reply_p99_ms"):
        return [LoopFault("low_success", UNDETERMINED, True, f"{words} The driver's diagnostics lack reply_p99_ms.")]
    reply = float(np.nanmedian(driver.values["reply_p99_ms"]))
    measured = (
        f"The driver replies within {reply:.2g} ms (99 %), and {1e3 * LOOP.reply:.2g} ms are left beside the network."
    )
    is_slow = reply > 1e3 * LOOP.reply
    cause = "the driver's own computation or a busy machine" if is_slow else "network or kernel"
    return [
        LoopFault(
            "low_success", COMPUTATION if is_slow else NETWORK, True, f"{words} Likely cause: {cause}. {measured}"
        )
    ]


def _missed_periods(bridge: NodeReports, missed: np.ndarray, period: float) -> list[LoopFault]:
    count, all_periods = int(missed.sum()), max(1, round(float(np.ptp(bridge.time)) / period))
    if count < LOOP.late * all_periods:
        return []
    evidence = _attribute(bridge, 1e3 * period * missed, 0.0 * missed, UNDETERMINED)
    waited = f"It waited {evidence.waited:.0f} ms for a processor, and {evidence.lost:.0f} ms were missed."
    if evidence.cause == BUSY:
        why = f"Likely cause: a busy machine. {waited}"
    else:
        why = f"The cause is not measured: its computation, or the host of a virtual machine. {waited}"
    words = f"The simulator missed {count} of {all_periods} periods ({100 * count / all_periods:.2g} %)."
    return [LoopFault("missed_periods", evidence.cause, False, f"{words} {why}")]


def _late_commands(
    record: LoopRecord, backend: NodeReports | None, controller: NodeReports | None, period: float, is_complete: bool
) -> tuple[list[LoopFault], float]:
    """States without a command, and commands that were refused as late; with their share. is_complete: whether what the recording lacks
    was not published."""
    first, last = record.commands[[0, -1]]
    states = record.states[(record.states >= first) & (record.states <= last)]
    missing = states[~np.isin(states, record.commands)] if is_complete else states[:0]
    refused = 0 if backend is None else int(backend.growth("refused_late").sum())
    share = (len(missing) + refused) / max(1, len(states))
    is_silent = backend is not None and _is_new(backend, SILENT)
    if share < LOOP.late and not is_silent:
        return [], share
    if controller is None:
        evidence = _Evidence(UNDETERMINED, 0.0, 0.0, 0.0)
    else:
        row = np.searchsorted(controller.time, missing)
        lost = 1e3 * period * np.bincount(row[row < len(controller.time)], minlength=len(controller.time))
        if refused:  # by the driver's report; the controller's next one is at most a second later
            at = np.clip(np.searchsorted(controller.time, backend.time), 0, len(controller.time) - 1)
            lost = lost + 1e3 * period * np.bincount(at, backend.growth("refused_late"), len(controller.time))
        slow = controller.latest("answer_p99_ms") > 1e3 * period
        evidence = _attribute(controller, lost, np.where(slow, lost, 0.0), MESSAGES)
    answer = "" if controller is None else f"{np.nanmedian(controller.values['answer_p99_ms']):.2g} ms"
    why = {
        BUSY: f"Likely cause: a busy machine. The controller waited {evidence.waited:.0f} ms for a processor.",
        COMPUTATION: f"Likely cause: the controller's computation. It answers within {answer} (99 %), and a period has {1e3 * period:.2g} ms.",
        MESSAGES: f"Likely cause: messages between driver and controller. The controller answers within {answer} (99 %) and waited {evidence.waited:.0f} ms for a processor.",
        UNDETERMINED: f"The cause is not recorded: the controller's diagnostics lack answer_p99_ms or {WAIT}.",
    }[evidence.cause]
    words = f"{len(missing)} of {len(states)} states had no command, and {refused} commands came too late ({100 * share:.2g} %)"
    words += "; the driver stopped the arm after 200 ms of silence." if is_silent else "."
    return [LoopFault("late_commands", evidence.cause, is_silent, f"{words} {why}")], share


def _late_targets(record: LoopRecord) -> list[LoopFault]:
    """Targets that the policy left out, or published more than a policy period after the data that they are for."""
    steps = np.diff(record.targets)
    steps = steps[steps < LOOP.pause]
    if len(steps) < 10:
        return []
    period = float(np.median(steps))
    left_out = int(np.round(steps / period - 1).clip(0).sum())
    age = record.sent - record.targets if len(record.sent) else np.zeros(0)
    late = int((age > period).sum())
    share = (left_out + late) / (len(steps) + left_out)
    if share < LOOP.late:
        return []
    ages = f", its targets are {1e3 * np.percentile(age, 99):.0f} ms old (99 %)" if len(age) else ""
    words = f"The policy left out {left_out} targets and sent {late} more than a period late ({100 * share:.2g} %)."
    why = f"Likely cause: the policy's machine: a period has {1e3 * period:.0f} ms{ages}."
    return [LoopFault("late_targets", POLICY, False, f"{words} {why}")]


def _lost_messages(backend: NodeReports, lost: float, record: LoopRecord, period: float) -> list[LoopFault]:
    """Joint states that the recording lacks beyond `lost` s of them, which were not published."""
    if any("state: fault" in text for text in backend.words) or len(backend.time) < 2:
        return []  # a driver that connects again goes on with later stamps
    begin, end = backend.time[0], backend.time[-1] - LOOP.settled
    gaps = _gaps(record.states, period)
    gaps = gaps[(gaps[:, 0] > begin) & (gaps[:, 0] < end)]
    missing = int(np.round(1e-3 * gaps[:, 1] / period).sum() - len(gaps) - lost / period)
    if missing < LOOP.late * (end - begin) / period:
        return []
    recorder = record.nodes.get("recorder")
    waited = 0.0 if recorder is None else float(recorder.growth(WAIT).sum())
    is_busy = waited >= LOOP.accounted * 1e3 * period * missing
    why = (
        f"a busy machine. The recorder waited {waited:.0f} ms for a processor"
        if is_busy
        else "recorder or disk, not the loop"
    )
    words = f"The recording lacks {missing} joint states that were published. Likely cause: {why}."
    return [LoopFault("lost_messages", BUSY if is_busy else RECORDER, False, words)]

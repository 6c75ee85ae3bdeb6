"""The HTML report of recorded episodes: one file with everything in it."""

from __future__ import annotations

import base64
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_common.html_pages import page
from np_common.intervals import wilson_interval
from np_description.force_reflex import FORCE_REFLEX
from np_description.panda import NOMINAL
from np_description.phases import PhaseState
from np_record.bag import Recording
from np_record.outcome import Outcome, note_position_only
from np_record.recorded_episode import EpisodeData, load_episode, read_images
from np_record.report import plots
from np_record.report.video import write_video


@dataclass(frozen=True)
class ReportSection:
    """One episode of the report."""

    name: str
    """Name of its bag."""
    episode: EpisodeData
    """Its data."""
    plots: dict[str, str]
    """SVG by title."""
    video: str
    """Data URI, "" where no image was recorded."""

    @property
    def rates(self) -> list[tuple[str, int, float]]:
        """(topic, messages, messages per simulated second) of what was published."""
        duration = max(self.episode.duration, 1e-9)
        return [(name, count, count / duration) for name, count in self.episode.counts.items() if count]

    @property
    def timeline(self) -> list[tuple[PhaseState, float, float]]:
        """(phase, start s, share of the episode in %) in order."""
        phases = self.episode.phases
        ends = [*(begin for begin, _ in phases[1:]), self.episode.duration]
        total = max(self.episode.duration, 1e-9)
        return [(state, begin, 100 * (end - begin) / total) for (begin, state), end in zip(phases, ends)]

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Names and figures of the outcome table."""
        episode, outcome = self.episode, self.episode.outcome
        torque = np.abs(episode.command.values) / NOMINAL.torque_limit
        facts = [
            ("declared", f"{outcome.declared}{': ' + outcome.reason if outcome.reason else ''}"),
            ("by the truth", "success" if outcome.success else f"failure in {outcome.failed_in}"),
            (
                "distance to goal",
                f"{100 * episode.distance.values[0]:.1f} cm → {100 * outcome.distance:.2f} cm",
            ),
            (
                "angle to goal",
                f"{np.degrees(episode.angle.values[0]):.0f}° → {np.degrees(outcome.angle):.1f}°{note_position_only(episode.domain)}",
            ),
            *_uncertainty(outcome),
            ("simulated time", f"{outcome.duration:.1f} s"),
            ("largest joint speed", _largest_speed(episode)),
            (
                "largest torque",
                f"{100 * torque.max():.0f} % of a joint's limit" if len(torque) else "no command",
            ),
        ]
        if len(episode.wrench):
            force = np.linalg.norm(episode.wrench.values[:, :3], axis=1).max()
            facts.append(("largest external force", f"{force:.0f} N; the robot stops at {FORCE_REFLEX.force:g} N"))
        if len(episode.keypoint_error):
            facts.append(
                (
                    "keypoint error",
                    f"median {np.median(episode.keypoint_error.values):.2f} px, "
                    f"95 % below {np.quantile(episode.keypoint_error.values, 0.95):.1f} px",
                )
            )
        return facts


def _uncertainty(outcome: Outcome) -> list[tuple[str, str]]:
    if outcome.position_bound is None or outcome.angle_bound is None:
        return []
    bounds = f"{1e3 * outcome.position_bound:.1f} mm, {np.degrees(outcome.angle_bound):.1f}°"
    return [("uncertainty of the graph's estimate", f"{bounds} (twice the standard deviation)")]


def _largest_speed(episode: EpisodeData) -> str:
    if not len(episode.velocity):
        return "no state"
    shares = (np.abs(episode.velocity.values) / NOMINAL.velocity_limit).max(0)
    return f"{100 * shares.max():.0f} % of the limit of joint {shares.argmax() + 1}"


def make_section(bag: str | Path, video_file: Path | None = None) -> ReportSection:
    """Read one bag and draw its plots; the video is also kept in `video_file` if given. Raises BagError."""
    with Recording(bag) as recording:
        episode = load_episode(recording)
        drawn = {
            "Distance and angle to the goal": plots.plot_progress(episode),
            "Commanded torque": plots.plot_torque(episode),
            **({"External force": plots.plot_force(episode)} if len(episode.wrench) else {}),
            "Joint speed": plots.plot_speed(episode),
            "Joint tracking": plots.plot_tracking(episode),
            "Depth of contact": plots.plot_depth(episode),
            "Keypoints against the projected truth": plots.plot_keypoints(episode),
            "From above": plots.plot_path(episode),
        }
        with tempfile.TemporaryDirectory() as folder:
            path = video_file or Path(folder) / "video.webm"
            rate = float(episode.information.get("image_rate", 30))
            frames = write_video(path, episode, read_images(recording), rate)
            data = base64.b64encode(path.read_bytes()).decode() if frames else ""
    return ReportSection(Path(bag).name, episode, drawn, f"data:video/webm;base64,{data}" if data else "")


def make_title(sections: list[ReportSection]) -> str:
    """What a report of these episodes is called: by their domains."""
    names = list(dict.fromkeys(section.episode.domain.name for section in sections))
    return f"{' and '.join(names)} episodes".capitalize()


def write_report(path: str | Path, sections: list[ReportSection]) -> None:
    """Write the report of `sections` to `path`."""
    successes = sum(section.episode.outcome.success for section in sections)
    low, high = wilson_interval(successes, len(sections))
    text = page(
        "np_record",
        title=make_title(sections),
        sections=sections,
        successes=successes,
        low=low,
        high=high,
        colours=plots.PHASE_COLOURS,
        position_only=note_position_only,
    )
    Path(path).write_text(text, encoding="utf-8")

"""docs/results: one page a set, and the index, newest first, from the data beside them and sets.yaml."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from pages import (
    chain,
    contact,
    doctor,
    driver,
    endurance,
    episodes,
    paper_table,
    perception,
    robots,
    sizes,
    speed,
    task_more,
)
from pages.markdown import head, paragraph, table
from pages.renamed import now

SETS = "sets.yaml"
DRIVER = ("tracking", "approach", "suite", "faults")
PICTURES = (".svg", ".png", "_strips.jpg", "_reliability.png", "_view.png")
INTRODUCTION = """Everything measured, newest first. All of it is simulated, but for sets on recordings that others
have published: no real arm or camera of ours has been used yet.
Released policies are trained in hard contacts, the card since 2026-11-25, wall and bump since 2026-11-24. Sets that are older, or named
soft, are of MuJoCo's default contacts, in which a fingertip sinks 2 to 6.6 mm into the card, which is 5 mm thick."""
# Kind of a set, as the index names it, by what its file is called: the first that fits.
KINDS: tuple[tuple[str, str, str, Callable[[Mapping], tuple[str, str]]], ...] = (
    ("evaluation_", "", "through the graph", episodes.evaluated),
    ("table3_", "", "through the graph", paper_table.tabled),
    ("other_sizes", "", "through the node's policies", sizes.sized),
    ("bump_first_look", "", "batched", episodes.first_look),
    ("training_", "", "batched", lambda data: episodes.trained(data["evaluations"], data)),
    ("", "_comparison", "batched", episodes.compared),
    ("", "_stiffness", "batched", episodes.compared),
    ("detector_", "_ablation", "detector", perception.ablation),
    ("detector_by_row", "", "detector", perception.by_row),
    ("detector_", "", "detector", perception.detector),
    ("calibration", "", "calibration", perception.calibration),
    ("blind_regression", "", "blind set", doctor.regression),
    ("blind_", "", "blind set", doctor.sealed),
    ("doctor_", "", "doctor", doctor.clean_arm),
    ("chain_clock", "", "doctor", chain.clock),
    ("chain_pushes", "", "doctor", contact.pushes),
    ("chain_slid", "", "doctor", contact.slid),
    ("task_locked_", "", "blind set", chain.task),
    ("task_others_", "", "blind set", task_more.others),
    ("task_harm_", "", "blind set", task_more.harm),
    ("task_put_down_", "", "blind set", task_more.put_down),
    ("robots_matrix", "", "blind set", robots.matrix),
    ("robots_", "", "blind set", robots.robots),
    ("identification_z1_delays", "", "identification", doctor.delays),
    ("identification_", "", "identification", doctor.identified),
    ("static_bench", "", "contact", contact.static_bench),
    ("contact_laws", "", "contact", contact.laws),
    ("bench", "", "bench", speed.bench),
    ("throughput_", "", "bench", speed.throughput),
    ("soak", "", "endurance", endurance.soak),
    ("fuzz", "", "endurance", endurance.fuzz),
)


@dataclass(frozen=True)
class Set:
    """One set of results: file of its data, title, date, note; what it is, in a line, and the body of its page."""

    file: str
    title: str
    date: str
    kind: str
    headline: str
    text: str

    @property
    def page(self) -> str:
        """File of its page."""
        return f"{self.file.split('.')[0]}.md"


def read(folder: Path) -> Iterator[Set]:
    """The sets that sets.yaml lists. Raises ValueError for data that it does not list, or of an unknown kind."""
    listed = yaml.safe_load((folder / SETS).read_text(encoding="utf-8"))
    data = {f.name for f in folder.iterdir() if f.suffix in (".json", ".jsonl") and not f.name.startswith("driver_")}
    if unlisted := data ^ set(listed):
        raise ValueError(f"{SETS}: expected an entry for each file of data, differs in {', '.join(sorted(unlisted))}")
    for file, entry in listed.items():
        yield _set(folder, file, **entry)


def _set(folder: Path, file: str, title: str, date: str = "", note: str = "", command: str = "") -> Set:
    stem, text = file.split(".")[0], (folder / file).read_text(encoding="utf-8")
    lines = file.endswith(".jsonl")
    data = {} if lines else json.loads(text)
    date = data.get("date", str(date))
    kind, read_one = _kind(stem)
    if lines:
        headline, body = episodes.trained([json.loads(line) for line in text.splitlines()], {})
    else:
        headline, body = read_one(data)
    command = command or data.get("command")
    about = [date, data.get("machine"), f"[data]({file})"]
    curve = folder / f"{stem}.csv"
    about += [f"[curve]({curve.name})"] if curve.exists() else []
    parts = [head(title, file), ", ".join(part for part in about if part), ".\n\n"]
    if isinstance(command, str) and kind != "identification":
        parts += [f"```\n{command}\n```\n\n", f"{said}\n\n" if (said := now(command)) else ""]
    parts += [paragraph(words) + "\n\n" for words in (note, data.get("note", "")) if words and kind != "identification"]
    pictures = [f"{stem}{end}" for end in PICTURES if (folder / f"{stem}{end}").exists()]
    parts += [body, *(f"\n![{picture.split('.')[0]}]({picture})\n" for picture in pictures)]
    return Set(file, title, date, kind, headline, "".join([*parts, "\n[All results](README.md)\n"]))


def _kind(stem: str) -> tuple[str, Callable[[Mapping], tuple[str, str]]]:
    for start, end, kind, read_one in KINDS:
        if stem.startswith(start) and stem.endswith(end):
            return kind, read_one
    raise ValueError(f"{stem}: expected data of a known kind: {', '.join(f'{s}*{e}' for s, e, _, _ in KINDS)}")


def pages(folder: Path) -> dict[str, str]:
    """Text of every page by its file, from the data in `folder`."""
    sets = list(read(folder))
    written = {one.page: one.text for one in sets}
    written["driver.md"] = driver.page(folder, DRIVER)
    rows = [(one.date, one.kind, f"[{one.title}]({one.page})", one.headline, f"[data]({one.file})") for one in sets]
    measured = json.loads((folder / "driver_tracking.json").read_text(encoding="utf-8"))
    arms = ", ".join(f"{row['control']} {row['hand_rms_mm']} mm rms at the hand" for row in measured["rows"])
    rows.append((measured["date"], "driver", "[What the driver did](driver.md)", arms, "[data](driver_tracking.json)"))
    order = [kind for _, _, kind, _ in KINDS]
    rows.sort(key=lambda row: order.index(row[1]) if row[1] in order else len(order))
    rows.sort(key=lambda row: row[0], reverse=True)
    index = head("Results", SETS, INTRODUCTION) + table(("date", "kind", "set", "result", ""), rows)
    return {"README.md": index, **written}

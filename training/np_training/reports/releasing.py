"""Trained policies made ready for others: weights as safetensors, a model card beside each, curves as data and a plot."""

from __future__ import annotations

import argparse
import datetime
import json
import shlex
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import torch

from np_description.domains import find_domain
from np_description.objects.choice import DEFAULT
from np_description.weights.header import read_metadata, tensors_sha256
from np_description.weights.released import WeightsError, weights_folder
from np_policy.contract import KINDS, POST_CONTACT, PRE_CONTACT
from np_policy.networks import PostContactNetwork, PreContactNetwork
from np_policy.size_generalization import SIZES
from np_policy.weights import load, save, sha256
from np_training.checkpoints import read_state
from np_training.contracts import make_trained_contract
from np_training.ppo.learner import learning_rate
from np_training.report import PHYSICS_STEPS, TrainingRun, read_run
from np_training.reports.curves import draw_curves
from np_training.reports.curves import save as save_figure
from np_training.setting import RESULTS, UNSAID, WEIGHTS, chosen, domain_of, setting_of

ROWS = 1500  # of a run's log that are released: of a longer one every second or third
_CARD = """# {title}

{what}

| | |
|---|---|
| file | `{file}`, sha256 `{digest}`, of its tensors alone `{tensors}` |
| domain | {domain} |
| object | {played} |
| data | simulated episodes only (MuJoCo Warp, `np_training.environment.environment`); no real data |
| training | {steps:.0f} M policy steps ({physics:.1f} G physics steps), seed {seed}, {machine} |
| command | `{command}` |
| released | {date} |

{note}{figures}
"""
_FILES = (
    (
        POST_CONTACT,
        "Post-contact policy",
        "Observation (79) to pose residual and joint gains (20), 10 Hz; see "
        "np_policy.observation and np_policy.action. Mean action; residual limits 0.02 m, 0.03 rad a step.",
    ),
    (
        PRE_CONTACT,
        "Pre-contact student",
        "Keypoints and goal keypoints (32) to the hand pose before contact and finger "
        "width (10); distilled from the teacher that sees poses.",
    ),
)


def without_optimisers(state: dict) -> dict:
    """A checkpoint with the learning rates in place of the optimisers, which are two thirds of it; also of one that has none."""
    return state | {name: {"rate": learning_rate(state[name])} for name in ("post", "pre")}


def figure_table(lines: list[dict]) -> str:
    """Markdown of `np_training.evaluate` results: by conditions, by kind of task, and what breaks first."""
    rows = [
        "| simulated conditions | contacts | contact from | success | 95 % interval | episodes | out of reach | lost "
        "| stopped by the reflex | timeout | force, 99 %, N |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    notes = []
    for r in lines:
        source = "student" if r["student"] else "teacher"
        force = f"{r['force']['filtered_n']['q99']:.0f}" if "force" in r else "-"
        rows.append(
            f"| {r['conditions']} | {r.get('contact', '-')} | {source} | {r['success']:.3f} | "
            f"{r['ci95'][0]:.3f} to {r['ci95'][1]:.3f} | "
            f"{r['episodes']} | {r['infeasible']} | {r['lost']} | {r.get('stopped', '-')} | {r['timeout']} | {force} |"
        )
        parts = [
            f"{name} {g['success']:.3f} ({g['episodes']})" for name, g in r.get("by_group", {}).items() if g["episodes"]
        ]
        if parts:
            notes.append(f"- {r['conditions']}, {source}, by kind of task: {', '.join(parts)}.")
        if "breaks_first" in r:
            alone = ", ".join(f"{name.replace('_', ' ')} {g['success']:.3f}" for name, g in r["one_at_a_time"].items())
            first = (r["breaks_first"] or "nothing beyond doubt").replace("_", " ")
            notes.append(f"- {source}, one range widened at a time: {alone}. What breaks first: {first}.")
        if "over_velocity_limit" in r:
            notes.append(
                f"- {r['conditions']}, {source}: physics steps over a limit, worst joint: velocity "
                f"{r['over_velocity_limit']['largest_joint_share']:.4%}, torque asked for "
                f"{r['over_torque_limit']['largest_joint_share']:.4%}."
            )
    return "\n".join(rows + ([""] + notes if notes else []))


def check_releasable(setting: dict, evaluations: list[dict]) -> None:
    """Raise ValueError for a run that was never evaluated, or not in the contacts of the domain's scene, or with another object."""
    if not evaluations:
        raise ValueError(
            "release: expected evaluation.jsonl with a line in the run's folder (np_training.evaluate --out)"
        )
    wrong = {line["domain"] for line in evaluations if "domain" in line} - {setting["domain"]}
    if wrong:
        raise ValueError(
            f"release: expected evaluations of {setting['domain']}, got some of {', '.join(sorted(wrong))}"
        )
    deployed, trained = find_domain(setting["domain"]).contact.name, setting.get("contact", UNSAID["contact"])
    if deployed not in (judged := {line.get("contact", trained) for line in evaluations}):
        raise ValueError(
            f"release: expected evaluations in {deployed} contacts, of which {setting['domain']}'s scene is made, got "
            f"{', '.join(sorted(judged))}"
        )
    played = setting.get("object", DEFAULT)
    if others := {line.get("object", DEFAULT) for line in evaluations} - {played}:
        raise ValueError(
            f"release: expected evaluations with object {played}, got some with {', '.join(sorted(others))}"
        )


def check_place(played: str, weights: Path) -> None:
    """Raise ValueError where weights for another object than the domain's own would lie where nodes look for its own."""
    if played == DEFAULT:
        return
    own = {WEIGHTS.resolve()}
    with suppress(WeightsError):
        own.add(weights_folder().resolve())
    if weights.resolve() in own:
        raise ValueError(
            f"release: expected --weights FOLDER, another than {weights}, for object {played}: from there the nodes load the "
            "weights for the domain's own object"
        )


def release(
    run: TrainingRun,
    state: dict,
    student: Path,
    weights: Path,
    results: Path,
    machine: str,
    command: str,
    note: str = "",
    object_ref: str | None = None,
) -> list[Path]:
    """Write weights with cards, training_DOMAIN.pt beside them, and training_DOMAIN.{json,csv,png} into results; returns
    the weights' files. note: what a user has to know of their behaviour; object_ref: the object that they are for (None: that of the
    training). Raises ValueError, and WeightsError, before anything is written."""
    setting = chosen(setting_of(state), object=object_ref)
    domain, played = domain_of(setting).name, setting["object"]
    check_releasable(setting, run.evaluations)
    check_place(played, weights)
    of_student = read_metadata(student)
    if (theirs := of_student.get("object", DEFAULT)) != played:
        raise ValueError(f"release: expected a student for object {played}, got one for {theirs}: {student}")
    seed = run.config.get("environment", {}).get("seed", 0)
    post = PostContactNetwork()
    post.load_state_dict({name[5:]: tensor for name, tensor in state["networks"].items() if name.startswith("post.")})
    contracts = {
        kind: make_trained_contract(kind, find_domain(domain), damping_floor=setting["damping_floor"]) for kind in KINDS
    }
    modules = {POST_CONTACT: post, PRE_CONTACT: load(PreContactNetwork(), student, contracts[PRE_CONTACT])}
    today = datetime.date.today().isoformat()
    weights.mkdir(parents=True, exist_ok=True)
    results.mkdir(parents=True, exist_ok=True)
    files = []
    for name, title, what in _FILES:
        file = weights / f"{name}_{domain}.safetensors"
        sizes = {SIZES: of_student[SIZES]} if name == PRE_CONTACT and SIZES in of_student else {}
        save(modules[name], file, contracts[name], {"domain": domain, "object": played, "date": today, **sizes})
        file.with_suffix(".md").write_text(
            _CARD.format(
                title=f"{title}, {domain}",
                what=what,
                file=file.name,
                digest=sha256(file),
                tensors=tensors_sha256(file),
                domain=domain,
                played=played,
                steps=state["steps"] / 1e6,
                physics=state["steps"] * PHYSICS_STEPS / 1e9,
                seed=seed,
                machine=machine,
                command=command,
                date=today,
                note=f"{note}\n\n" if note else "",
                figures=figure_table(run.evaluations),
            )
        )
        files.append(file)
    torch.save(without_optimisers(state), weights / f"training_{domain}.pt")
    heading, *lines = (run.path / "log.csv").read_text().splitlines(keepends=True)
    (results / f"training_{domain}.csv").write_text(heading + "".join(lines[:: -(-len(lines) // ROWS)]))
    save_figure(draw_curves(run.rows), results / f"training_{domain}.png")
    (results / f"training_{domain}.json").write_text(
        json.dumps(
            {
                "command": command,
                "seed": seed,
                "object": played,
                "machine": machine,
                "date": today,
                "note": note,
                "policy_steps": state["steps"],
                "physics_steps": state["steps"] * PHYSICS_STEPS,
                "training_s": run.rows[-1]["elapsed"],
                "evaluations": run.evaluations,
            },
            indent=1,
        )
        + "\n"
    )
    return files


def release_run(arguments: argparse.Namespace, refuse: Callable[[str], NoReturn]) -> dict:
    """Release the run that the command line names; returns the content of its last line. refuse: called with a line on why it cannot be released."""
    try:
        run, state = read_run(arguments.run), read_state(arguments.run / "checkpoint.pt", "cpu")
    except ValueError as error:
        refuse(str(error))
    machine = arguments.machine or f"{run.config.get('processes', 1)} x {run.config.get('device', 'unknown')}"
    command = arguments.command or shlex.join(
        ["python", "-m", "np_training.train", *run.config.get("command", [""])[1:]]
    )
    try:
        played = chosen(setting_of(state), object=arguments.object)["object"]
        results = arguments.results or (RESULTS if played == DEFAULT else arguments.weights)
        files = release(
            run, state, arguments.student, arguments.weights, results, machine, command, arguments.note, played
        )
    except ValueError as error:
        refuse(str(error))
    return {"files": [str(file) for file in files], "object": played}

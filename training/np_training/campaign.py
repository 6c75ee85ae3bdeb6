"""Train several domains one after the other on all GPUs: each through its stages, then its student and its figures.

    python -m np_training.campaign card wall bump --out runs/hard --minutes 27

Every stage is a run of `np_training.train`, `np_training.distill` or `np_training.evaluate` of its own, and what is there already is
not done again: a campaign that was killed goes on where its checkpoints are, on any machine. Each GPU takes the next domain
when it has finished one. `--minutes` is what training may take on one GPU. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_training.options import duration
from np_training.train_options import CHECKPOINT

DISTIL_MINUTES = 1.0
CONDITIONS = ("nominal", "paper", "quarter_stiffness", "fourfold_stiffness")


@dataclass(frozen=True)
class Stage:
    """A share of a domain's time in contacts of one hardness. back_to: the curriculum's stage at which it begins again."""

    contact: str
    share: float
    back_to: int | None = None


@dataclass(frozen=True)
class Recipe:
    """share: of a GPU's time, where domains stand beside one another; stages, whose shares sum to 1; begin: checkpoint to start
    from, where there is one."""

    share: float
    stages: tuple[Stage, ...]
    begin: Path | None


RECIPES = {
    # From nothing it learns in contacts that are stepped three times as fast before it meets hard ones.
    "card": Recipe(2.0, (Stage("firm", 0.45), Stage("swift", 0.55)), Path("weights/training_card.pt")),
    # From nothing: what was learned in soft contacts lifts the box with the housing, and bare metal does not hold it (docs/decisions/policies.md).
    "wall": Recipe(2.0, (Stage("firm", 0.65), Stage("swift", 0.35)), None),
    # From the released one, first without randomisation, which it could not meet at once.
    "bump": Recipe(1.0, (Stage("swift", 1.0, back_to=10),), Path("weights/training_bump.pt")),
}

Run = Callable[[Sequence[str], int | None], None]
"""Runs a module with its arguments on a GPU (None: the CPU); raises CalledProcessError."""


def next_stage(stages: tuple[Stage, ...], seconds: float, trained: float) -> tuple[int, float] | None:
    """Which stage comes after `trained` s of a domain's `seconds`, and the s left of it; None when all are over.

    A rest of less than a second is not worth the start of a process.
    """
    end = 0.0
    for number, stage in enumerate(stages):
        end += stage.share * seconds
        if end - trained > 1.0:
            return number, end - trained
    return None


def is_at_beginning(stages: tuple[Stage, ...], number: int, left: float, seconds: float) -> bool:
    """Whether of a stage's time nothing is over but what is lost between two processes."""
    return left >= stages[number].share * seconds - 1.0


def shares(domains: Sequence[str], minutes: float, gpus: int) -> dict[str, float]:
    """Minutes of training for each of the domains (at least one), such that the busiest of so many GPUs is done after `minutes`
    where each takes the next domain when it has finished one."""
    free = [0.0] * gpus
    for name in domains:
        busiest = min(range(gpus), key=free.__getitem__)
        free[busiest] += RECIPES[name].share
    return {name: minutes * RECIPES[name].share / max(free) for name in domains}


def train_domain(name: str, out: Path, seconds: float, options: Sequence[str], gpu: int | None, run: Run) -> Path:
    """All stages of a domain; its checkpoint."""
    recipe, checkpoint, begun = RECIPES[name], out / name / CHECKPOINT, out / name / "campaign.json"
    begun.parent.mkdir(parents=True, exist_ok=True)
    begin = recipe.begin if recipe.begin and recipe.begin.exists() else None
    source = checkpoint if checkpoint.exists() else begin
    if not begun.exists():
        begun.write_text(json.dumps({"before_s": _seconds(source), "from": str(source)}))
    before = json.loads(begun.read_text())["before_s"]
    while (due := next_stage(recipe.stages, seconds, _seconds(source) - before)) is not None:
        number, left = due
        arguments = ["--domain", name, "--out", str(out / name), "--contact", recipe.stages[number].contact]
        arguments += ["--conditions", "robust", "--minutes", f"{left / 60:.3f}", *options]
        if source is not None:
            arguments += ["--resume", str(source)]
        stage, so_far = recipe.stages[number], _seconds(source)
        if stage.back_to is not None and source is not None and is_at_beginning(recipe.stages, number, left, seconds):
            arguments += ["--stage", str(stage.back_to)]
        run(["np_training.train", *arguments], gpu)
        source = checkpoint
        if _seconds(source) <= so_far:
            raise RuntimeError(
                f"campaign: {name}: expected {checkpoint} to have been trained for more than {so_far:.0f} s"
            )
    return checkpoint


def finish_domain(name: str, out: Path, episodes: int, gpu: int | None, run: Run) -> None:
    """The student of a trained domain, and the figures of both, where they are not there yet."""
    folder = out / name
    student, figures = folder / f"pre_contact_student_{name}.safetensors", folder / "evaluation.jsonl"
    checkpoint = ["--checkpoint", str(folder / CHECKPOINT)]
    if not student.exists():
        run(["np_training.distill", *checkpoint, "--out", str(folder), "--minutes", str(DISTIL_MINUTES)], gpu)
    if not figures.exists():
        partial = figures.with_suffix(".partial")
        partial.unlink(missing_ok=True)
        for chooser in ([], ["--student", str(student)]):
            arguments = ["--conditions", *CONDITIONS, "--episodes", str(episodes), "--out", str(partial)]
            run(["np_training.evaluate", *checkpoint, *chooser, *arguments], gpu)
        os.replace(partial, figures)


def campaign(
    domains: Sequence[str], out: Path, minutes: float, episodes: int, gpus: Sequence[int | None], options, run: Run
) -> dict[str, str]:
    """Domains by what became of each: "done", or what went wrong; one that fails leaves the others alone."""
    times, outcome = shares(domains, minutes, len(gpus)), {}
    free: SimpleQueue[int | None] = SimpleQueue()
    for gpu in gpus:
        free.put(gpu)

    def one(name: str) -> None:
        gpu = free.get()
        try:
            train_domain(name, out, 60 * times[name], options, gpu, run)
            finish_domain(name, out, episodes, gpu, run)
            outcome[name] = "done"
        except (subprocess.CalledProcessError, RuntimeError, OSError) as error:
            outcome[name] = str(error)
        finally:
            free.put(gpu)

    with ThreadPoolExecutor(len(gpus)) as pool:
        list(pool.map(one, domains))
    return {name: outcome[name] for name in domains}


def _seconds(checkpoint: Path | None) -> float:
    """s for which a checkpoint was trained."""
    if checkpoint is None:
        return 0.0
    from np_training.checkpoints import read_state  # slow: no --help should wait for PyTorch

    return float(read_state(checkpoint, "cpu").get("seconds", 0.0))


def run_module(arguments: Sequence[str], gpu: int | None) -> None:
    """See `Run`; its lines are printed with the GPU's number in front."""
    environment = dict(os.environ)
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = str(gpu)
    command = [sys.executable, "-u", "-m", *arguments]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        _relay(process.stdout, f"[{'cpu' if gpu is None else gpu}] ")
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)


_PRINTING = threading.Lock()


def _relay(lines: Iterable[str], mark: str) -> None:
    for line in lines:
        with _PRINTING:
            print(mark + line, end="", file=sys.stderr, flush=True)


def main() -> None:
    """The campaign that the command line asks for."""
    parser = Parser(description=__doc__.splitlines()[0], epilog="Other options go to np_training.train.")
    parser.add_argument("domains", nargs="+", choices=list(DOMAINS))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=duration, default=27.0, help="of training on each GPU")
    parser.add_argument("--episodes", type=int, default=3000, help="of each condition")
    arguments, options = parser.parse_known_args()
    import torch

    gpus: list[int | None] = list(range(torch.cuda.device_count())) or [None]
    outcome = campaign(
        arguments.domains, arguments.out, arguments.minutes, arguments.episodes, gpus, options, run_module
    )
    print(json.dumps({"domains": outcome, "gpus": torch.cuda.device_count(), "out": str(arguments.out)}))
    if any(value != "done" for value in outcome.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()

"""Policies trained on with a patch: `np_training.train` from the released checkpoint, then `np_training.distill`, each a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sim2real.effects.patch import Patch, dump_patch

from np_common.cli import Progress
from np_common.parallel import SINGLE_THREAD
from np_common.parent_process import end_with_parent
from np_description.contact.model import HARD
from np_description.domains import find_domain
from np_description.weights.released import weights_folder
from np_policy.contract import POST_CONTACT, PRE_CONTACT

ON_CPU = ("--device", "cpu", "--worlds", "128")
DISTIL_SHARE = 0.15  # of the time for training; the student is taught on from the one that is there
DONE = "learned.json"
SAVE_EVERY = "30"  # s between checkpoints, with which a training that is killed goes on


class TrainingInterrupted(OSError):
    """Training was ended from outside; what it has saved is gone on from."""


@dataclass(frozen=True)
class Learning:
    """How policies are finetuned."""

    minutes: float
    """Of training, from its first update on."""
    gpu: int | None = None
    """Number of the GPU; None: the CPU."""
    seed: int = 0
    """Of the training."""
    options: tuple[str, ...] = ()
    """Further options of np_training.train."""


def split_trainable(patch: Patch) -> tuple[Patch, list[str]]:
    """The part of a patch that training has in its simulator, and the names of the effects that are left out."""
    kept = [e for e in patch.effects if "training" in e.definition.supported_in]
    left = [f"{e.effect} at {e.component}" for e in patch.effects if "training" not in e.definition.supported_in]
    return Patch(tuple(kept)), left


def read_training_result(out: Path) -> dict | None:
    """The result of `train_and_distill` in a folder; None where it has not finished."""
    done = out / DONE
    return json.loads(done.read_text(encoding="utf-8")) if done.exists() else None


def train_and_distill(
    domain: str,
    patch: Patch,
    out: Path,
    how: Learning,
    weights: str = "",
    is_over: Callable[[], bool] = lambda: False,
) -> dict:
    """Train on and distil into out/weights; the results that both print last. The folder of the old weights is not changed.

    out/weights_old_student has the new policy with the old student, whose contacts are those that the planner expects where the camera is off.
    Done once out/learned.json is there. is_over: called every second; True ends it at once. Raises TrainingInterrupted, and OSError where
    training ends with an error (with the last line of the log) or there is no checkpoint to go on from.
    """
    if (known := read_training_result(out)) is not None:
        return known
    begun = time.monotonic()
    folder = weights_folder(weights)
    checkpoint = folder / f"training_{domain}.pt"
    if not checkpoint.exists():
        raise OSError(f"{checkpoint}: expected a checkpoint to go on from, there is none")
    out.mkdir(parents=True, exist_ok=True)
    effects = out / "trained_with.yaml"  # beside patch.yaml, of which it may be a part
    effects.write_text(dump_patch(patch), encoding="utf-8")
    run = out / "training"
    train = [
        *_training(domain, how), "--out", str(run), "--effects", str(effects),
        "--minutes", f"{how.minutes:g}", "--from-first", "--show-every", "10", "--save-every", SAVE_EVERY,
    ]  # fmt: skip
    if not (run / "checkpoint.pt").exists():  # else it goes on with what was begun
        train += ["--resume", str(checkpoint)]
    trained = _run(train, out / "train.log", 60 * how.minutes, "train", how.gpu, is_over)
    distil = [
        "np_training.distill", "--checkpoint", str(run / "checkpoint.pt"), "--out", str(run), "--effects", str(effects),
        "--minutes", f"{DISTIL_SHARE * how.minutes:g}", "--seed", str(how.seed),
        "--begin", str(folder / f"{PRE_CONTACT}_{domain}.safetensors"), "--weights", str(out / "weights"),
        *(("--device", "cpu", "--batch", "512") if how.gpu is None else ()),
    ]  # fmt: skip
    student = _run(distil, out / "distil.log", 60 * DISTIL_SHARE * how.minutes, "distil", how.gpu, is_over)
    mixed = out / "weights_old_student"
    mixed.mkdir(exist_ok=True)
    for place, kind in ((folder, PRE_CONTACT), (out / "weights", POST_CONTACT)):
        shutil.copyfile(place / f"{kind}_{domain}.safetensors", mixed / f"{kind}_{domain}.safetensors")
    found = {
        "train": trained,
        "distil": student,
        "weights": str(out / "weights"),
        "weights_old_student": str(mixed),
        "device": "cpu" if how.gpu is None else f"cuda {how.gpu}",
        "wall_s": round(time.monotonic() - begun, 1),
    }
    (out / DONE).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def _training(domain: str, how: Learning) -> list[str]:
    """Arguments of the training for the domain's contacts and their randomisation."""
    hard = find_domain(domain).contact.name == HARD.name
    where = ON_CPU if how.gpu is None else ()
    robust = ("--conditions", "robust") if hard else ()
    return ["np_training.train", "--domain", domain, "--seed", str(how.seed), *robust, *where, *how.options]


def _run(
    arguments: Sequence[str],
    log: Path,
    seconds: float,
    what: str,
    gpu: int | None,
    is_over: Callable[[], bool] = lambda: False,
) -> dict:
    """Run a module until it ends, about `seconds`; its last line, which is JSON. Raises OSError with its last line, and TrainingInterrupted."""
    environment = dict(os.environ)
    if gpu is not None:
        # Of those that this process sees, which may be some of the machine's.
        seen = environment.get("CUDA_VISIBLE_DEVICES") or ",".join(map(str, range(gpu + 1)))
        environment["CUDA_VISIBLE_DEVICES"] = seen.split(",")[gpu]
        environment |= dict.fromkeys(SINGLE_THREAD, "2")
    progress, begun = Progress(max(1, round(seconds)), what), time.monotonic()
    with log.open("w", encoding="utf-8") as lines:
        with subprocess.Popen(
            [sys.executable, "-u", "-m", *arguments],
            stdout=lines,
            stderr=subprocess.STDOUT,
            env=environment,
            preexec_fn=end_with_parent,
        ) as process:
            try:
                while process.poll() is None:
                    if is_over():
                        raise TrainingInterrupted(f"{arguments[0]} was ended ({log})")
                    progress.show(min(round(time.monotonic() - begun), round(seconds) - 1))
                    try:
                        process.wait(1.0)
                    except subprocess.TimeoutExpired:
                        continue
            except BaseException:
                process.terminate()
                raise
    words = log.read_text(encoding="utf-8").strip().splitlines()
    if process.returncode:
        raise OSError(
            f"{' '.join(arguments[:1])} ended with status {process.returncode}: {words[-1] if words else ''} ({log})"
        )
    progress.show(max(1, round(seconds)), "done")
    return _last_json(words, log)


def _last_json(words: Sequence[str], log: Path) -> dict:
    """The last line that is a JSON object: libraries may print lines after it. Raises OSError where there is none."""
    for line in reversed(words):
        if line.startswith("{"):
            try:
                return json.loads(line)
            except ValueError:
                continue
    raise OSError(f"{log}: expected a line of JSON, there is none")


def list_gpus() -> list[int]:
    """Numbers of the GPUs that are there."""
    import torch  # slow

    return list(range(torch.cuda.device_count()))

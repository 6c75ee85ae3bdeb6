"""What comes after a recipe's last stage: the student, the figures of both policies, and a page. What is there already is not done again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from np_description.domains import find_domain
from np_training.recipe import Recipe, read_recipe
from np_training.train_options import CHECKPOINT


def steps_after(path: Path, recipe: Recipe, out: Path, device: str) -> list[tuple[Path, list[str]]]:
    """What is left to do for a trained run in `out`, in order: the file that each step leaves, and its module with arguments."""
    checkpoint, student = out / CHECKPOINT, out / f"pre_contact_student_{recipe.domain}.safetensors"
    figures, there = out / "evaluation.jsonl", ["--device", device]
    options = []
    for name, value in recipe.distil.items():
        options += [f"--{name}", *map(str, value if isinstance(value, list) else [value])]
    distil = [
        "np_training.distill",
        "--checkpoint",
        str(checkpoint),
        "--out",
        str(out),
        "--weights",
        str(out / "weights"),
    ]
    judge = ["np_training.evaluate", "--checkpoint", str(checkpoint), "--student", str(student), "--recipe", str(path)]
    # Trained in contacts that grow, the policies are deployed in the scene's: judged in both.
    in_scene, contact = out / "evaluation_scene.jsonl", find_domain(recipe.domain).contact.name
    steps = [
        (student, [*distil, *options, *there]),
        (figures, [*judge, "--out", str(figures.with_suffix(".partial")), *there]),
        (in_scene, [*judge, "--contact", contact, "--out", str(in_scene.with_suffix(".partial")), *there]),
        (out / "report.html", ["np_training.report", str(out)]),
    ]
    return [(file, step) for file, step in steps if not file.exists()]


def finish(path: Path, out: Path, device: str) -> None:
    """Do what is left after the training of the recipe in `path`. Raises CalledProcessError where a step fails."""
    for file, step in steps_after(path, read_recipe(path), out, device):
        partial = file.with_suffix(".partial")
        partial.unlink(missing_ok=True)
        subprocess.run([sys.executable, "-m", *step], check=True, stdout=sys.stderr)
        if partial.exists():
            os.replace(partial, file)

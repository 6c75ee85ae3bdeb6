"""What to do with the result: the commands of the gap loop (docs/guide/close_the_gap.md), as far as the verdict goes."""

from __future__ import annotations

from pathlib import Path

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis

RECORD = "ros2 run np_diagnosis excite --backend running --mode realtime"


def suggest_next_steps(diagnosis: Diagnosis, folder: Path) -> list[tuple[str, str]]:
    """(what it is for, command), in order; none where there is nothing to do, or no simulator of this arm. folder: of the report."""
    if diagnosis.verdict == "no_gap" or diagnosis.context.reference or diagnosis.context.arm.joints != NOMINAL.joints:
        return []
    patch, student = folder / "patch.yaml", "--student runs/patched/pre_contact_student_wall.safetensors"
    verify = [
        ("Record motions that the diagnosis has not seen", f"{RECORD} --only sweep_2 sweep_4 --out runs/fresh"),
        (
            "Hold the patch against them: better, same or worse",
            f"ros2 run np_diagnosis diagnose runs/fresh_000 --out runs/verified --patch {patch}",
        ),
    ]
    if diagnosis.verdict == "unexplained":
        return [("Record once more, after looking at the joint", f"{RECORD} --out runs/suite"), *verify[1:]]
    return [
        *verify,
        ("See what it does to the task", f"make evaluate DOMAIN=wall EFFECTS={patch}"),
        (
            "Train again with it, where the task suffers",
            f'make train DOMAIN=wall ARGS="--resume weights/training_wall.pt --effects {patch} --minutes 5 --out runs/patched"',
        ),
        (
            "Distil",
            "python -m np_training.distill --checkpoint runs/patched/checkpoint.pt --out runs/patched --minutes 1",
        ),
        (
            "Judge, which a release needs",
            f"python -m np_training.evaluate --checkpoint runs/patched/checkpoint.pt {student} --out runs/patched/evaluation.jsonl",
        ),
        ("Release", f"python -m np_training.release runs/patched {student}"),
        ("See whether the task has come back", f"make evaluate DOMAIN=wall EFFECTS={patch} ARGS=--fresh"),
    ]

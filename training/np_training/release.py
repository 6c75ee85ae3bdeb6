"""Release trained policies: weights as safetensors, a model card beside each, curves as data and a plot.

    python -m np_training.release --checkpoint runs/card/checkpoint.pt --student runs/card/pre_contact_student_card.safetensors \\
        --log runs/card/log.csv --machine "1 x NVIDIA H200"
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import shutil
from pathlib import Path

import torch

from np_description.domains import DOMAINS
from np_policy.networks import PostContactPolicy, PreContactStudent
from np_policy.weights import load, save, sha256

_CARD = """# {title}

{what}

| | |
|---|---|
| file | `{file}`, sha256 `{digest}` |
| domain | {domain} |
| data | simulated episodes only (MuJoCo Warp, `np_training.environment`); no real data |
| training | {steps:.0f} M policy steps ({physics:.1f} G physics steps), seed {seed}, {machine} |
| command | `{command}` |
| released | {date} |

{figures}
"""


def figure_table(lines: list[dict]) -> str:
    """A Markdown table of `np_training.evaluate` results."""
    rows = ["| simulated conditions | contact from | success | 95 % interval | episodes | lost | timeout |", "|---|---|---|---|---|---|---|"]
    for r in lines:
        rows.append(f"| {r['conditions']} | {'student' if r['student'] else 'teacher'} | {r['success']:.3f} | "
                    f"{r['ci95'][0]:.3f} to {r['ci95'][1]:.3f} | {r['episodes']} | {r['lost']} | {r['timeout']} |")
    return "\n".join(rows)


def plot_curves(log: Path, picture: Path) -> None:
    """Success, curriculum stage, reward terms and episode length against policy steps."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with log.open() as file:
        rows = list(csv.DictReader(file))
    steps = [float(r["steps"]) / 1e6 for r in rows]
    columns = {name: [float(r[name] or "nan") for r in rows] for name in rows[0]}
    figure, axes = plt.subplots(2, 2, figsize=(11, 6.5), sharex=True)
    axes[0, 0].plot(steps, columns["success"], color="C2")
    axes[0, 0].set(ylabel="success of ended episodes", ylim=(0, 1))
    stage = axes[0, 0].twinx()
    stage.step(steps, columns["stage"], color="0.5", where="post")
    stage.set(ylabel="curriculum stage (11: randomised)", ylim=(0, 12))
    for name in ("progress", "success", "gains", "failure"):
        axes[0, 1].plot(steps, columns[f"reward_{name}"], label=name)
    axes[0, 1].set(ylabel="reward a step, scaled")
    axes[0, 1].set_yscale("symlog", linthresh=1e-3)
    axes[0, 1].legend()
    axes[1, 0].plot(steps, columns["length"], label="length, steps")
    axes[1, 0].plot(steps, [1e3 * d for d in columns["end_distance"]], label="distance at the end, mm")
    axes[1, 0].set(xlabel="million policy steps", ylim=(0, 120))
    axes[1, 0].legend()
    axes[1, 1].plot(steps, columns["pre_feasible"], label="feasible contacts")
    axes[1, 1].plot(steps, columns["lost"], label="objects lost")
    axes[1, 1].plot(steps, columns["std"], label="action deviation")
    axes[1, 1].set(xlabel="million policy steps", ylim=(0, 1))
    axes[1, 1].legend()
    figure.tight_layout()
    figure.savefig(picture, dpi=110)


def main() -> None:
    """Write weights/{pre,post}_contact_DOMAIN.safetensors with cards, and docs/results/training_DOMAIN.{json,csv,png}."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--student", type=Path, required=True)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--evaluation", type=Path, required=True, help="lines printed by np_training.evaluate")
    parser.add_argument("--command", default="python -m np_training.train --domain card")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--machine", required=True)
    parser.add_argument("--weights", type=Path, default=Path("weights"))
    parser.add_argument("--results", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    domain = arguments.domain
    state = torch.load(arguments.checkpoint, map_location="cpu", weights_only=True)
    evaluations = [json.loads(line) for line in arguments.evaluation.read_text().splitlines()]
    arguments.weights.mkdir(exist_ok=True)
    arguments.results.mkdir(parents=True, exist_ok=True)
    post = PostContactPolicy()
    post.load_state_dict({name[5:]: tensor for name, tensor in state["networks"].items() if name.startswith("post.")})
    student = load(PreContactStudent(), arguments.student)
    today = datetime.date.today().isoformat()
    for name, module, title, what in (
            ("post_contact", post, "Post-contact policy", "Observation (79) to pose residual and joint gains (20), 10 Hz; "
             "see np_policy.observation and np_policy.action. Mean action; residual limits 0.02 m, 0.03 rad a step."),
            ("pre_contact", student, "Pre-contact student", "Keypoints and goal keypoints (32) to the hand pose before "
             "contact and finger width (10); distilled from the teacher that sees poses.")):
        file = arguments.weights / f"{name}_{domain}.safetensors"
        save(module, file, {"domain": domain, "date": today})
        file.with_suffix(".md").write_text(_CARD.format(
            title=f"{title}, {domain}", what=what, file=file.name, digest=sha256(file), domain=domain,
            steps=state["steps"] / 1e6, physics=state["steps"] * 20 / 1e9, seed=arguments.seed, machine=arguments.machine,
            command=arguments.command, date=today, figures=figure_table(evaluations)))
    shutil.copyfile(arguments.log, arguments.results / f"training_{domain}.csv")
    plot_curves(arguments.log, arguments.results / f"training_{domain}.png")
    (arguments.results / f"training_{domain}.json").write_text(json.dumps({
        "command": arguments.command, "seed": arguments.seed, "machine": arguments.machine, "date": today,
        "policy_steps": state["steps"], "physics_steps": state["steps"] * 20, "evaluations": evaluations}, indent=1) + "\n")


if __name__ == "__main__":
    main()

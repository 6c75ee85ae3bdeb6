"""docs/results/training.md: how the released policies were trained and judged, from the training_*.json files beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from pages.evaluations import TASKS
from pages.markdown import head, paragraph, rate, table

INTRODUCTION = """Policies are trained in MuJoCo Warp, then judged in batches of 1,000 episodes with mean actions and true corners. "Student" is the
released pre-contact policy, which sees what the real one sees. The intervals are Wilson's at 95 %."""
READING = """The weights are of the recipes in `recipes/`, from nothing. All three runs ended before their recipe's end. In the tables each row has 1,000
episodes of the student, judged with the reflex at 40 N. In training the reflex stops an episode at 40 N of filtered force, times a factor of 0.6 to
1.0. Forces are the largest of an episode, N, filtered over 10 ms but for the last column. Steady contacts grow from nothing at first touch; the
scenes of the graph have hard ones."""
BEFORE = {
    "card": """`make train DOMAIN=card SEED=1`, from nothing, in five calls of 88 minutes together. All randomisation was met at 113 M steps. The
curve's dips are where the run was resumed: all episodes begin anew there. To 743 M steps goals were turned by up to 90 degrees, from 624 M steps on in
hard contacts. The last 312 M steps have goals of any yaw and contacts that each episode draws between growing and hard ones, at 259,000 policy steps a
second on one H200. Both learning rates began the second stage at 5e-5, set by hand. An episode may take 20 s here, in the graph 30 s.""",
    "bump": """`make train DOMAIN=bump SEED=1`, from nothing, in several calls of 96 minutes together. Its first stage had 1,307 M steps in growing
contacts; randomisation grew in ten steps, each at a success of 0.8, and reached the eighth. Two stages followed in contacts that each episode draws
between growing and hard ones. In the first of them, 163 M steps, force costs three times as much and the reflex is at 0.4 to 0.8 of 40 N. In the
second, 137 M steps, force costs half of that and stiffness is drawn to twelve times. The curve's data is thinned.""",
    "wall": """`make train DOMAIN=wall SEED=1`, from nothing, in two calls of 12.9 and 20 minutes. Randomisation grows in ten steps, each at a
success of 0.8; the run ended in the eighth.""",
}
AFTER = {
    "card": """To 90 degrees, as the release before, nominal success in hard contacts is 1.000 of 502 (before 0.996), with four times the stiffness
0.916 (0.919), with a tenth of the mass 0.964 (0.930). What fails in hard contacts are turns beyond 135 degrees, out of time: nominal 23 of 259, with four
times the stiffness 204. In steady contacts all three goals for any yaw are met: nominal 0.99, `paper` 0.97, four times as stiff 0.92. In hard
contacts none is. Next: a stage in hard contacts, which took the release before from 0.795 to 0.919 at four times the stiffness. The student is 0.47 mm
from its teacher.""",
    "bump": """The student had 5 minutes of distillation and is 1.2 mm from its teacher, in the mean of tasks of sizes 0.8, 1 and 1.2. The policy
itself is what fails at other sizes. At 0.8 most failures are late, at 1.2 most are stopped by the reflex. At 1.2 the housing touches in 9 % of the
steps with touch, at the nominal size in 3 %. `robust` has what the run has not met yet.""",
    "wall": """`robust` has what the run has not met yet: of its failures, half are stopped by the reflex. At 1.2 times the size the housing touches
in 7 % of the steps with touch.""",
}
SEEDS = """Card and wall were trained again from nothing: `make train DOMAIN=wall SEED=2 GPUS=2 ARGS="--minutes 17.5"`, and the same for the card,
beside each other on four H100 ([data](training_seeds.json), 2026-11-28). Rows are in hard contacts. Neither seed is released."""
AFTER_SEEDS = """Two GPUs double the worlds of an update, so seed 2 of the wall had half as many updates as the release. Its curve had not levelled off.
The card's recipe then had a second stage, goals of any yaw; it had 172 M steps and reached 0.908 in growing contacts. In hard contacts it is too slow
at the end: 448 of 449 nominal failures are timeouts. After 2.5 minutes of distillation the students are 0.55 mm (card) and 0.12 mm (wall) from their
teachers."""
STAGES = """The last two stages changed the bump as the rows of its first stage show ([data](training_seeds.json), 2026-11-29). The wall went on from
its release on one H200, too: in hard contacts alone, 92 M steps; in drawn contacts with force at three times its price, 68 M; and from there, like
the bump, at half of that price and with stiffness drawn to twelve times, 65 M. Its stages are not released."""
AFTER_STAGES = """In drawn contacts the bump fails less in every row, also by the reflex; at 1.2 times the size it is stopped half as often. In hard
contacts alone the wall loses success in growing ones, whose rows there are in steps of 4 ms. In drawn contacts it presses least, but too little for
stiff contacts. In hard contacts ten times as stiff 0.898 of 128 episodes succeed under `paper`, after the longer run 0.922 of 1,000; the others run
out of time. The release has 1.000 of 128. PhysX showed the same: 20 of 24 of the first run by true corners, three of the others out of time. So the
recipes judge at ten times the stiffness from now on. Next for the wall: more steps there, for the longer run had not levelled off."""
REST = """`experiments/nano_push.py` ([data](training_forces.json)) reaches a success of 0.933 at the residual limits of deployment after 70 M steps and
271 s on one H100. The fused contact solver gives 292,380 policy steps a second for the wall, the library's solver 124,001. For the card the figures
are 329,538 and 134,215. Both are rollouts of 24,576 worlds in growing contacts on one H100."""
JUDGED = (
    "conditions",
    "contacts",
    "success, 95 % Wilson interval",
    "out of reach",
    "lost",
    "stopped by the reflex",
    "out of time",
    "force, median",
    "99 %",
    "raw, 99 %",
)
COMPARED = ("nominal", "paper", "stiffness 4", "size .8", "size 1.2", "mass .1", "robust")


def page(folder: Path) -> str:
    """Text of the page."""
    runs = {task: json.loads((folder / f"training_{task}.json").read_text(encoding="utf-8")) for task in TASKS}
    released = (
        (
            task,
            run["date"],
            f"{run['policy_steps'] / 1e6:,.0f} M",
            f"{run['training_s']:,.0f} s",
            run["seed"],
            run["machine"].replace(" x ", " "),
            f"[curve](training_{task}.csv), [judged](training_{task}.json)",
        )
        for task, run in runs.items()
    )
    others = json.loads((folder / "training_seeds.json").read_text(encoding="utf-8"))
    seeds, stages = others["runs"], others["last_stages"]
    return "".join(
        [
            head("Training of the released policies", "training_*.json", INTRODUCTION),
            table(("task", "released", "policy steps", "training time", "seed", "hardware", "data"), released),
            f"\n{paragraph(READING)}\n",
            *(part for task, run in runs.items() for part in _task(task, run)),
            f"\n## Second seeds\n\n{paragraph(SEEDS)}\n\n",
            table(("task", "policy steps", *COMPARED), _compared(runs, seeds)),
            f"\n{paragraph(AFTER_SEEDS)}\n\n## Last stages\n\n{paragraph(STAGES)}\n\n",
            table(("task", "contacts", *COMPARED, "beyond 25 N, paper"), _stages(runs, stages)),
            f"\n{paragraph(AFTER_STAGES)}\n\n## Teaching piece and solver\n\n{paragraph(REST)}\n",
        ]
    )


def _task(task: str, run: Mapping) -> Iterator[str]:
    yield f"\n## {task.capitalize()}\n\n{paragraph(BEFORE[task])}\n\n"
    yield table(JUDGED, map(_judged, run["evaluations"]))
    yield f"\n{paragraph(AFTER[task])}\n\n![{task}](training_{task}.png)\n"


def _judged(row: Mapping) -> tuple:
    counts = (row[name] for name in ("infeasible", "lost", "stopped", "timeout"))
    filtered, raw = row["force"]["filtered_n"], row["force"]["raw_n"]
    forces = (f"{value:.0f}" for value in (filtered["median"], filtered["q99"], raw["q99"]))
    return row["conditions"], row["contact"], rate(row["success"], row["ci95"]), *counts, *forces


def _compared(runs: Mapping[str, Mapping], seeds: Mapping[str, Mapping]) -> Iterator[tuple]:
    for task, other in seeds.items():
        of_release = {r["conditions"]: r["success"] for r in runs[task]["evaluations"] if r["contact"] == "hard"}
        of_seed = {r[0]: r[2] for r in other["judged"] if r[1] == "hard"}
        for name, steps, rates in (
            (f"{task}, released", runs[task]["policy_steps"], of_release),
            (f"{task}, seed 2", other["policy_steps"], of_seed),
        ):
            yield name, f"{steps / 1e6:,.0f} M", *(f"{rates[c]:.3f}" for c in COMPARED)


def _stages(runs: Mapping[str, Mapping], stages: Mapping) -> Iterator[tuple]:
    over = stages["columns"].index("over_25_n")
    for task in dict.fromkeys(stage["task"] for stage in stages["runs"]):
        of_release = {
            (row["conditions"], row["contact"]): (row["success"], row["force"]["over_25_n"])
            for row in runs[task]["evaluations"]
        }
        found = {"released": of_release} | {
            stage["name"]: {(row[0], row[1]): (row[2], row[over]) for row in stage["judged"]}
            for stage in stages["runs"]
            if stage["task"] == task
        }
        for name, rows in found.items():
            for contact in dict.fromkeys(contact for _, contact in rows):
                rates = (f"{rows[c, contact][0]:.3f}" for c in COMPARED)
                yield f"{task}, {name}", contact, *rates, rows["paper", contact][1]

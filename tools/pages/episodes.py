"""Results that count episodes: through the graph, in the batched simulator, and of runs beside one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from pages.markdown import rate, table


def evaluated(data: Mapping) -> tuple[str, str]:
    """Headline and body of an evaluation through the graph."""
    episodes, ended = data["per_episode"], [e for e in data["per_episode"] if e["distance"] is not None]
    successes = sum(e["success"] for e in episodes)
    distance = 1e3 * median(e["distance"] for e in ended)
    headline = f"{successes} of {len(episodes)} ({data['ci95'][0]:.2f} to {data['ci95'][1]:.2f}), {distance:.1f} mm"
    settings = data["settings"]
    rows = [
        ("success, 95 % Wilson interval", rate(data["success"], data["ci95"])),
        *(
            [("of these with the first contact", rate(*data["first_contact"].values()))]
            if "first_contact" in data
            else []
        ),
        ("failures by phase", ", ".join(f"{k}: {v}" for k, v in data["failures"].items()) or "none"),
        ("median distance at the end", f"{distance:.1f} mm"),
        ("median angle at the end", f"{median(e['angle'] for e in ended):.4f} rad"),
        ("median simulated time", f"{median(e['duration'] for e in ended):.1f} s"),
        ("declared a success and was none", data["declared_wrongly"]),
        ("was a success and not declared", data["missed"]),
        ("wall time", f"{data['wall_s']:.0f} s"),
        ("controller", settings["controller"]),
        ("effects", settings["effects"]),
        ("revision", f"`{settings['revision']}`"),
    ]
    body = table(("figure", "value"), rows)
    failed = [e for e in episodes if not e["success"]]
    if failed:
        body += "\n## Episodes that failed\n\n" + table(
            ("episode", "phase", "declared", "reason", "distance, mm", "angle, rad", "simulated, s"),
            (
                (
                    e["episode"],
                    e["failed_in"],
                    e["declared"],
                    e["reason"],
                    1e3 * e["distance"] if e["distance"] is not None else None,
                    e["angle"],
                    e["duration"],
                )
                for e in failed
            ),
        )
    return headline, body


def trained(evaluations: Sequence[Mapping], run: Mapping) -> tuple[str, str]:
    """Headline and body of a trained policy in the batched simulator; run: what is known of its training."""
    steps = {e["steps"] for e in evaluations}
    when = [f" at {e['steps'] / 1e6:.0f} M steps" if len(steps) > 1 and e["steps"] else "" for e in evaluations]
    said = [
        f"{e['conditions']}{', student' if e['student'] else ''}{at}: {e['success']:.3f}"
        for e, at in zip(evaluations, when)
    ]
    body = ""
    if run:
        rows = [
            (name, run.get(key))
            for name, key in (("policy steps", "policy_steps"), ("training, s", "training_s"), ("seed", "seed"))
        ]
        body = table(("run", ""), rows) + "\n"
    header = ("conditions", "contact from", "success, 95 % Wilson interval", "episodes", "out of reach", "lost")
    body += table(
        (*header, "stopped by the reflex", "out of time", "speed limit", "torque limit"),
        (
            (
                e["conditions"] + at,
                _contact(e),
                rate(e["success"], e["ci95"]),
                e["episodes"],
                e["infeasible"],
                e["lost"],
                e.get("stopped"),
                e["timeout"],
                _share(e.get("over_velocity_limit")),
                _share(e.get("over_torque_limit")),
            )
            for e, at in zip(evaluations, when)
        ),
    )
    body += "\nLimits: the share of physics steps beyond them, of the joint that is beyond them most.\n"
    for evaluation in evaluations:
        if evaluation.get("one_at_a_time"):
            body += "\nOne range widened to twice at a time (student):\n\n" + table(
                ("range", "success, 95 % Wilson interval"),
                (
                    (name.replace("_", " "), rate(one["success"], one["ci95"]))
                    for name, one in evaluation["one_at_a_time"].items()
                ),
            )
    return "; ".join(said), body


def _contact(evaluation: Mapping) -> str:
    start = evaluation.get("start", "contact")
    return ("student" if evaluation["student"] else "teacher") if start == "contact" else f"fixed: {start}"


def _share(limit: Mapping | None) -> str:
    return "" if limit is None else f"{1e6 * limit['largest_joint_share']:.0f} in a million"


def compared(data: Mapping) -> tuple[str, str]:
    """Headline and body of runs beside one another."""
    rows = []
    for name, run in data["runs"].items():
        reached, end = run["reached"], run["end"]
        nominal = next((e for e in run["evaluations"] if e["conditions"] == "nominal"), None)
        rows.append(
            (
                name,
                f"{end['steps'] / 1e6:.0f} M",
                f"{end['success']:.3f}",
                "" if reached is None else f"{reached['steps'] / 1e6:.0f} M, {reached['seconds'] / 60:.1f} min",
                "" if nominal is None else rate(nominal["success"], nominal["ci95"]),
            )
        )
    header = ("run", "policy steps", "success at the end, sampled", f"{data['success']:g} reached at")
    return f"{len(rows)} runs", table((*header, "nominal, mean actions"), rows)


def first_look(data: Mapping) -> tuple[str, str]:
    """Headline and body of the bump's first run, which learned nothing."""
    mean = data["mean_action_episodes_gpu"]
    body = f"{data['what']}\n\n" + table(
        ("figure", "value"),
        (
            ("policy steps", data["policy_steps"]),
            ("success, mean actions", rate(mean["success"], mean["ci95"])),
            ("episodes", mean["episodes"]),
            ("note", mean["note"]),
        ),
    )
    return rate(mean["success"], mean["ci95"]), body

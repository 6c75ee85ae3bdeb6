"""`evaluate`: lockstep episodes through the whole graph, scored by the true object pose."""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import wait
from pathlib import Path

from np_bringup.backends import ENGINES
from np_common.cli import Parser, Progress
from np_common.parallel import workers
from np_description.domains import DOMAINS, Task
from np_description.objects.choice import DEFAULT, domain_with, embed_object_text
from np_description.objects.scenarios import COUNT
from np_description.weights.provenance import origin
from np_evaluation.commands.episode_options import add_options, check_options, run_command
from np_evaluation.results import Results, split_runs
from np_evaluation.run_episodes import RunRequest, play, play_part
from np_evaluation.scoring import code_sha256, summary

IMAGE_RATE = 10  # the policy's: images between its ticks cost time and change nothing


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="evaluate", description=__doc__)
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--object", default=DEFAULT, help="a row of the domain's table of objects, or a .yaml file")
    parser.add_argument(
        "--scenario", type=int, choices=range(COUNT + 1), default=0, help="a fixed task; 0: tasks are drawn"
    )
    parser.add_argument(
        "--effects", default="none", help="patch.yaml of effects that the simulated arm has; none: nominal"
    )
    parser.add_argument("--bags", action="store_true", help="record every episode (slower)")
    parser.add_argument(
        "--fresh", action="store_true", help="run every episode anew, whatever is kept of the same code"
    )
    add_options(parser, jobs=1, out="runs/evaluate")
    options = parser.parse_args(arguments)
    check_options(parser, options, ("episodes",))
    try:
        options.object = embed_object_text(options.domain, options.object)
    except ValueError as error:
        parser.error(str(error))
    if options.cluster:  # its workers were started elsewhere
        options.out = options.out.resolve()
        options.weights = str(Path(options.weights).resolve()) if options.weights else ""
    if options.effects != "none":
        from sim2real.effects.patch import load_patch  # slow, as what the functions below import

        try:
            load_patch(options.effects)
        except ValueError as error:
            parser.error(str(error))
        options.effects = str(Path(options.effects).resolve())
    return options


def evaluate(options: argparse.Namespace) -> dict[str, object]:
    """Run what is missing of the requested episodes; the summary of all of them.

    A graph that breaks down costs its episode; one that does not come up at all raises. Weights that were trained for
    something else raise WeightsError before anything is started. The summary has the `warnings` of `warnings_of`.
    """
    warnings = warnings_of(options)
    for warning in warnings:
        print(f"evaluate: {warning}", file=sys.stderr)
    where = origin(options.weights)
    results = Results(options.out, settings_of(options, where), options.fresh)
    kept = min(results.kept, options.episodes)
    if kept:
        print(
            f"kept from {results.kept_from}, {kept} of {options.episodes} episodes: code and weights are the same; "
            "--fresh runs them anew",
            file=sys.stderr,
        )
    request = request_of(options, where)
    before = sum(result.wall_s for result in results.results[:kept])
    progress, started = Progress(options.episodes, f"evaluate {options.domain}"), time.monotonic()
    missing_runs = results.missing(options.episodes)
    if options.jobs == 1 and not options.cluster:
        for numbers in missing_runs:
            play(request, numbers, results, lambda n, s: progress.show(n + min(0.9, s / 15), rate(results)))
    elif missing_runs:
        run_parallel(request, missing_runs, results, options, progress)
    progress.show(options.episodes, rate(results))
    played = {"object": options.object, "scenario": options.scenario}
    figures = {"engine": options.engine, **played, **summary(results.results[: options.episodes])}
    took = time.monotonic() - started
    figures["this_run_s"], figures["wall_s"] = round(took, 1), round(before + took, 1)
    return {**figures, "kept": kept, "warnings": warnings, "results": str(results.path)}


def settings_of(options: argparse.Namespace, where: dict[str, object]) -> dict[str, object]:
    """The settings that episodes must share to be counted together. where: provenance."""
    return {
        "domain": options.domain,
        "engine": options.engine,
        "seed": options.seed,
        "keypoints": options.keypoints,
        "controller": "impedance",
        "object": options.object,
        **({"scenario": options.scenario} if options.scenario else {}),
        **({"contacts": options.contacts} if options.contacts > 1 else {}),
        "effects": "none" if options.effects == "none" else Path(options.effects).read_text(encoding="utf-8"),
        "code_sha256": code_sha256(),
        **where,
    }


def request_of(options: argparse.Namespace, where: dict[str, object]) -> RunRequest:
    """The launch arguments of the episodes."""
    return RunRequest(
        {
            "domain": options.domain,
            "object": options.object,
            "scenario": str(options.scenario),
            "backend": ENGINES[options.engine],
            "seed": str(options.seed),
            "keypoints": options.keypoints,
            "contacts": str(options.contacts),
            "image_rate": str(IMAGE_RATE),
            "effects": "" if options.effects == "none" else options.effects,
            "weights": options.weights,
            "record_at_start": "false",
            "bag": str(options.out / "bags" / "episode") if options.bags else "",
            "run_info": json.dumps(where),
        },
        options.engine,
        options.bags,
        options.out,
    )


def warnings_of(options: argparse.Namespace) -> list[str]:
    """How the weights differ from what runs here without being refused: contract, size of the object.

    Also the parameters of the effects that are clipped to what is physical.
    """
    from sim2real.effects.patch import load_patch

    from np_policy.contract import check_weights

    domain = domain_with(options.domain, options.object)
    effects = [] if options.effects == "none" else load_patch(options.effects).list_clipped_parameters()
    return [*check_weights(domain, options.weights), *size_warnings(domain, options.weights), *effects]


def size_warnings(domain: Task, weights: str) -> list[str]:
    """A line where the object's edges differ from those that the post-contact policy was trained with."""
    from np_policy.contract import POST_CONTACT, policy_metadata, weights_file
    from np_policy.size_generalization import find_trained_domain, read_size_range

    metadata = policy_metadata(weights_file(POST_CONTACT, domain, weights))
    sizes = read_size_range(metadata)
    known = find_trained_domain(domain, metadata.get("object", DEFAULT), sizes)
    if known is None:
        return []
    ours, theirs = (" x ".join(f"{2000 * half:.0f}" for half in one.half_size) for one in (domain, known))
    trained = f"{theirs} mm" if sizes == (1.0, 1.0) else f"{theirs} mm times {sizes[0]:g} to {sizes[1]:g}"
    factors = ", ".join(f"{a / b:.2f}" for a, b in zip(domain.half_size, known.half_size))
    return [f"object: {ours} mm, the policy was trained with {trained} (factors {factors}): expect fewer successes"]


def run_parallel(
    request: RunRequest, runs: list[range], results: Results, options: argparse.Namespace, progress
) -> None:
    """Play runs of episodes in several graphs at a time, each in a process of its own; what is finished is kept, whatever ends it."""
    try:
        with workers(options.jobs, options.cluster) as pool:
            playing = {
                pool.submit(play_part, request, part, results.part(part)) for part in split_runs(runs, options.jobs)
            }
            while playing:
                done, playing = wait(playing, timeout=1.0)
                for future in done:
                    future.result()
                progress.show(results.finished())
    finally:
        results.collect()


def rate(results: Results) -> str:
    """Success so far, for the progress bar."""
    successes = sum(r.success for r in results.results)
    return f"success {successes}/{len(results.results)}" if results.results else ""


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    options = parse(arguments)
    return run_command("evaluate", lambda: evaluate(options), lambda figures: (figures, 0))


if __name__ == "__main__":
    raise SystemExit(main())

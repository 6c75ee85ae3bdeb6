"""Success of trained policies in the batched simulator at zeta*, and how they fail.

    python -m np_training.evaluate --checkpoint runs/card/checkpoint.pt [--student FILE] \\
        --conditions nominal paper twice --episodes 1000 --seeds 1000 1001 --out runs/card/evaluation.jsonl

One JSON object a line and condition, printed and appended to --out. `twice` widens friction, mass and noise
to twice the range that training draws from, all together, then one at a time, and names what breaks first.
Domain, object, start, controller and time limit are the checkpoint's. `reward` of a line says which one trained it. In place of one, --released DOMAIN plays the weights
that the nodes load, contacts chosen by the student. --video N draws episodes, half of them failures where there are as
many.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from np_control.operational_space import uniform_gains
from np_description import limit_share
from np_description.depths import Tally
from np_description.domains import DOMAINS, find_domain
from np_description.objects.choice import DEFAULT
from np_description.objects.scenarios import COUNT
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract, weights_file
from np_policy.networks import PreContactStudent
from np_policy.weights import load
from np_record.intervals import wilson_interval
from np_training.environment.environment import Environment, EnvironmentConfig
from np_training.environment.fixed_contact import STARTS, FixedContact
from np_training.episodes.episodes import MODES, Episodes, concatenate, run_episodes
from np_training.episodes.recording import save_recording
from np_training.physics.batched import CONTROLLERS, STEPPING, PhysicsConfig, physics_for
from np_training.physics.carried_effects import load_effects
from np_training.ppo.networks import ActorCritic
from np_training.setting import OBJECT_HELP, UNSAID, chosen, domain_of, setting_of
from np_training.tasks.randomisation import CONDITIONS, GROUPS, PAPER, widen
from np_training.tasks.registry import find_task


def rate(success: np.ndarray) -> dict:
    """Share, 95 % Wilson interval and number of a mask (n,); the share of none is None."""
    count, hits = len(success), int(success.sum())
    low, high = wilson_interval(hits, count) if count else (0.0, 1.0)
    return {
        "success": hits / count if count else None,
        "ci95": [round(low, 4), round(high, 4)],
        "episodes": count,
    }


def summarise(episodes: Episodes, substeps: int) -> dict:
    """The figures of a set of episodes; a policy step has `substeps` physics steps."""
    success, reached = episodes.of("success"), ~episodes.of("infeasible")
    steps = max(float(episodes.length[reached].sum()) * substeps, 1.0)
    over = episodes.over[:, reached].sum(1) / steps
    failures = {}
    for mode in MODES[1:]:
        mask = episodes.of(mode)
        if mask.any():
            failures[mode] = {"episodes": int(mask.sum())}
            if mode != "infeasible":  # these were not played
                failures[mode] |= {
                    "median_end_distance_mm": round(1e3 * float(np.nanmedian(episodes.distance[mask])), 1),
                    "median_end_angle_rad": round(float(np.nanmedian(episodes.angle[mask])), 3),
                }
    return {
        **rate(success),
        **{mode: int(episodes.of(mode).sum()) for mode in MODES[1:]},
        "mean_steps_to_success": float(episodes.length[success].mean()) if success.any() else None,
        "over_velocity_limit": {
            "largest_joint_share": float(over[0].max()),
            "by_joint": [round(float(x), 6) for x in over[0]],
        },
        "over_torque_limit": {
            "largest_joint_share": float(over[1].max()),
            "by_joint": [round(float(x), 6) for x in over[1]],
        },
        "depth_mm": Tally.summary([episodes.depths]).as_dict(),
        "limit_share": limit_share.summary(episodes.shares[:, reached].transpose(1, 0, 2)),
        "by_group": {name: rate(success[mask]) for name, mask in episodes.groups.items()},
        "failures": failures,
    }


def evaluate(
    environment: Environment,
    networks: ActorCritic,
    student: PreContactStudent | None = None,
    start: str = "contact",
    conditions: str | None = None,
    seeds: tuple[int | None, ...] = (None,),
    record: Path | None = None,
    scenario: int = 0,
) -> dict:
    """One episode in every world for each seed; conditions: a key of CONDITIONS, or the environment's own
    where None. record: file for the recording of the first seed's. scenario: see `run_episodes`."""
    chooser = networks.pre if start == "contact" else FixedContact(start)

    def play(wanted) -> Episodes:
        parts = []
        for number, seed in enumerate(seeds):
            recorded = record is not None and number == 0 and wanted is here
            parts.append(run_episodes(environment, networks, chooser, student, wanted, seed, recorded, scenario))
            if recorded:
                save_recording(record, environment.domain.name, parts[0])
        return concatenate(parts)

    here = CONDITIONS.get(conditions, environment.config.conditions)
    figures = summarise(play(here), environment.config.physics.substeps)
    if conditions == "twice":
        alone = {name: rate(play(widen(PAPER, [name])).of("success")) for name in GROUPS}
        figures |= {
            "one_at_a_time": alone,
            "breaks_first": breaks_first(rate(play(PAPER).of("success")), alone),
        }
    return figures | {"worlds_over_capacity": int(environment.physics.take_overflowed())}


def breaks_first(base: dict, alone: dict[str, dict]) -> str | None:
    """The widened group with the least success; None where no group's interval lies below that of the trained
    range."""
    worse = {name: figures["success"] for name, figures in alone.items() if figures["ci95"][1] < base["ci95"][0]}
    return min(worse, key=worse.get) if worse else None


def read_checkpoint(path: Path) -> tuple[ActorCritic, dict, int]:
    """Networks of a training run, its setting, and its policy steps."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    networks = ActorCritic()
    networks.load_state_dict(state["networks"])
    return networks, setting_of(state), state["steps"]


def released_networks(domain: str) -> tuple[ActorCritic, dict, None]:
    """Networks whose post-contact policy is the released one of a domain, and its setting; the others, which are not
    released, are untrained. Raises WeightsError where the weights are missing or were trained for something else."""
    networks, task = ActorCritic(), find_task(domain)
    contract = PolicyContract.of(POST_CONTACT, task.domain, UNSAID["controller"])
    load(networks.post, weights_file(POST_CONTACT, task.domain), contract)
    setting = {"domain": domain, "limit": task.limit, "contact": task.domain.contact.name}
    return networks, setting_of({"setting": setting}), None


def main() -> None:
    """Evaluate checkpoints; every line printed is one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), help="default: the checkpoint's")
    parser.add_argument("--object", help=f"{OBJECT_HELP}; default: the checkpoint's")
    parser.add_argument(
        "--scenario", type=int, choices=range(COUNT + 1), default=0, help="a fixed task; 0: tasks are drawn"
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--checkpoint", type=Path)
    source.add_argument("--released", choices=list(DOMAINS), help="the weights that the nodes load, of a domain")
    parser.add_argument(
        "--student", type=Path, help="weights that choose the contact from keypoints, in the teacher's place"
    )
    parser.add_argument("--episodes", type=int, default=1000, help="of each seed")
    parser.add_argument("--conditions", nargs="+", choices=list(CONDITIONS), default=["nominal"])
    parser.add_argument("--seeds", "--seed", nargs="+", type=int, default=[1000])
    parser.add_argument("--hold", type=int, default=3, help="steps at the goal that count as success")
    parser.add_argument(
        "--reflex",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="whether joints beyond their limits of speed or position end an episode",
    )
    parser.add_argument("--start", choices=list(STARTS), help="default: the checkpoint's")
    parser.add_argument("--controller", choices=CONTROLLERS, help="default: the checkpoint's")
    parser.add_argument("--cartesian-stiffness", type=float, help="default: the checkpoint's")
    parser.add_argument("--limit", type=int, help="steps an episode; default: the checkpoint's")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument(
        "--effects", type=Path, help="patch.yaml of the gap doctor: what the arm has besides the nominal one"
    )
    parser.add_argument(
        "--contact", choices=list(STEPPING), help="see np_description.contact; default: the checkpoint's"
    )
    parser.add_argument("--out", type=Path, help="file to which the lines are appended")
    parser.add_argument(
        "--record", type=Path, help="file (.npz) for the joint positions of the last condition's episodes"
    )
    parser.add_argument("--video", type=int, metavar="N", help="draw N of the recorded episodes beside --record")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    if arguments.video and not arguments.record:
        parser.error("--video needs --record FILE, beside which it writes")
    try:
        effects = load_effects(arguments.effects)
    except ValueError as error:
        parser.error(str(error))
    networks, setting, steps = (
        released_networks(arguments.released) if arguments.released else read_checkpoint(arguments.checkpoint)
    )
    networks.to(arguments.device)
    if arguments.released and not arguments.student:
        arguments.student = weights_file(PRE_CONTACT, find_domain(arguments.released))
    try:
        setting = chosen(setting, **{name: getattr(arguments, name, None) for name in setting})
        domain = domain_of(setting)
    except ValueError as error:
        parser.error(str(error))
    if arguments.video and setting["object"] != DEFAULT:
        parser.error("--video draws a domain's own object: leave it out with another")
    contract = PolicyContract.of(PRE_CONTACT, find_domain(setting["domain"]), setting["controller"])
    student = load(PreContactStudent(), arguments.student, contract).to(arguments.device) if arguments.student else None
    environment = Environment(
        domain,
        arguments.device,
        EnvironmentConfig(
            worlds=arguments.episodes,
            hold=arguments.hold,
            reflex=arguments.reflex,
            limit=setting["limit"],
            physics=physics_for(
                setting["contact"],
                contacts=arguments.contacts,
                constraints=arguments.constraints,
                controller=setting["controller"],
                cartesian=uniform_gains(setting["cartesian_stiffness"]),
                effects=effects,
                supports=any(CONDITIONS[name].support is not None for name in arguments.conditions),
            ),
        ),
    )
    for conditions in arguments.conditions:
        begin = time.monotonic()
        record = arguments.record if conditions == arguments.conditions[-1] else None
        figures = evaluate(
            environment,
            networks,
            student,
            setting["start"],
            conditions,
            tuple(arguments.seeds),
            record,
            arguments.scenario,
        )
        line = json.dumps(
            {
                "conditions": conditions,
                "student": bool(student),
                **setting,
                "scenario": arguments.scenario,
                "effects": [f"{e.effect} at {e.component}" for e in effects.effects],
                "seeds": arguments.seeds,
                "steps": steps,
                **figures,
                "wall_s": round(time.monotonic() - begin, 1),
            }
        )
        if arguments.video and record:
            from np_training.video import draw_recording

            draw_recording(record, record.parent, arguments.video)
        print(line, flush=True)
        if arguments.out:
            with arguments.out.open("a") as file:
                file.write(line + "\n")


if __name__ == "__main__":
    main()

"""What `np_training.train` can be told, and what it does where it is not told."""

from __future__ import annotations

import argparse
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS, Domain, find_domain
from np_description.objects.choice import DEFAULT
from np_description.panda import FINGER_MAX
from np_training.device import DEVICE_HELP, usable
from np_training.options import count, duration
from np_training.physics.carried_effects import load_effects
from np_training.physics.config import CONTROLLERS, LEARNED_IN, STEPPING, PhysicsConfig
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import STAGES, CurriculumConfig
from np_training.setting import OBJECT_HELP, STARTS, domain_of
from np_training.tasks.paper_reward import PaperReward
from np_training.tasks.rewards import RewardConfig

CHECKPOINT = "checkpoint.pt"  # in the folder of a run


def parse() -> argparse.Namespace:
    """The command line, with the task's defaults; `played`: the domain as it is played, `reward`: the reward itself."""
    parser = Parser(description="Joint training of the pre- and post-contact policies.")
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--object", default=DEFAULT, help=OBJECT_HELP)
    parser.add_argument("--out", type=Path, help="default: runs/DOMAIN")
    parser.add_argument("--resume", type=Path, help="checkpoint to start from; default: OUT/checkpoint.pt, if any")
    parser.add_argument(
        "--stage", type=int, help=f"of the curriculum, at which what is resumed begins again (0 to {STAGES})"
    )
    parser.add_argument("--minutes", type=duration, default=20.0)
    parser.add_argument(
        "--from-first", action="store_true", help="count minutes from the end of the first iteration, which compiles"
    )
    parser.add_argument("--iterations", type=count, default=10**9)
    parser.add_argument("--save-every", type=float, default=120.0, help="seconds between checkpoints")
    parser.add_argument(
        "--show-every", type=float, default=60.0, help="seconds between lines where there is no terminal"
    )
    parser.add_argument("--worlds", type=count, default=24576, help="of each process")
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", help=DEVICE_HELP)
    parser.add_argument("--rate-limit", type=float, default=PPOConfig.rate[1], help="largest learning rate")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument("--entropy", type=float, default=PPOConfig.entropy, help="weight of the entropy bonus")
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        default=PhysicsConfig.controller,
        help="osc: operational-space control of T_E, its stiffness in each direction and its damping chosen by the policy",
    )
    parser.add_argument(
        "--start",
        choices=list(STARTS),
        default=TrainConfig.start,
        help="where episodes begin: contact: where the pre-contact policy says",
    )
    parser.add_argument(
        "--effects", type=Path, help="patch.yaml of the gap doctor: what the arm has besides the nominal one"
    )
    parser.add_argument("--contact", choices=list(STEPPING), help="see np_description.contact; default: the domain's")
    parser.add_argument(
        "--conditions",
        choices=(
            "paper",
            "robust",
            "servoed",
            "shoved",
            "strange",
            "restrained",
            "jostled",
            "light",
            "sized",
            "sized_ends",
        ),
        default=TrainConfig.conditions,
        help="what is randomised at the end: paper; robust: also stiffness of contacts, housing, limits of speed, place of the camera; "
        "servoed: with the goal seen by that camera; shoved: and objects that slip; strange: servoed, and contacts and fingertips of other engines; "
        "restrained: strange, with less of the limits; jostled: restrained, and objects that slip; "
        "light: strange, and objects of a tenth to twice the mass; "
        "sized: servoed, and objects of .8 to 1.2 times the size; sized_ends: sized, half of them at the two ends",
    )
    parser.add_argument("--adaptive-joint-range", action="store_true", help="see np_training.tasks.joint_range")
    parser.add_argument(
        "--curriculum",
        choices=("residual", "none"),
        default="residual",
        help="none: residual limits at zeta* from the first step",
    )
    parser.add_argument("--discount", type=float, default=PPOConfig.discount)
    parser.add_argument(
        "--target-kl", type=float, default=PPOConfig.target_kl, help="divergence that steers the learning rate"
    )
    parser.add_argument("--limit", type=int, help="steps an episode; default: the task's")
    parser.add_argument("--explore", type=float, help="share of random contacts at the beginning; default: the task's")
    practice = parser.add_mutually_exclusive_group()
    practice.add_argument("--practice", type=float, help="share of easier tasks at the beginning; default: the task's")
    practice.add_argument(
        "--no-practice",
        dest="practice",
        action="store_const",
        const=0.0,
        help="the domain's own tasks alone, with no obstacle sunk (paper)",
    )
    parser.add_argument(
        "--kept",
        type=float,
        default=CurriculumConfig.kept,
        help="share of practice that stays to the end; default: none",
    )
    parser.add_argument(
        "--max-opening",
        type=float,
        help=f"of one finger, m, at a pre-contact action of 1: up to {FINGER_MAX} (paper); default: the domain's",
    )
    parser.add_argument(
        "--privileged",
        action=argparse.BooleanOptionalAction,
        default=TrainConfig.privileged,
        help="whether the critic sees poses, randomised factors and the time left beside what the policy sees",
    )
    parser.add_argument(
        "--reward",
        choices=(RewardConfig.name, PaperReward.name),
        default=RewardConfig.name,
        help="paper: np_training.tasks.paper_reward, in place of potentials",
    )
    parser.add_argument(
        "--far", type=float, help="weight of the distance's own potential; default: the task's; not with --reward paper"
    )
    parser.add_argument(
        "--stiffness",
        type=float,
        default=0.0,
        help="stiffness that an untrained policy commands, -1 to 1 of its range",
    )
    parser.add_argument(
        "--deviation",
        type=float,
        help="largest standard deviation of the actions drawn, for a run's end; default: none",
    )
    parser.add_argument(
        "--widen",
        type=float,
        help="with --resume: smallest standard deviation of both policies' actions to begin with, so that a settled policy searches again",
    )
    parser.add_argument("--largest-turn", type=float, help="rad, from start to goal; default: the domain's")
    parser.add_argument(
        "--hold", type=int, default=TrainConfig.hold, help="steps at the goal that count as success once randomised"
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        help="share of the domain's tolerance that counts as success once randomised; default: what the domain aims at",
    )
    parser.add_argument(
        "--reflex",
        action=argparse.BooleanOptionalAction,
        default=TrainConfig.reflex,
        help="whether joints beyond their limits of speed or position end an episode once randomised",
    )
    parser.add_argument(
        "--bare",
        type=float,
        help=f"for a step that ends with housing or links at the object; default: {RewardConfig.bare:g}; not with --reward paper",
    )
    parser.add_argument(
        "--change",
        type=float,
        help=f"price of the pose residual's squared change from step to step; default: {RewardConfig.change:g}; not with --reward paper",
    )
    parser.add_argument(
        "--hidden",
        type=float,
        help=f"price of a step at whose end the arm hides all corners from the camera; default: {RewardConfig.hidden:g}; not with --reward paper",
    )
    parser.add_argument(
        "--turn",
        type=float,
        help=f"weight of the angle's potential; default: {RewardConfig.turn:g}; not with --reward paper",
    )
    arguments = parser.parse_args()
    if arguments.widen is not None and not (arguments.resume and arguments.widen > 0):
        parser.error(f"--widen: expected a deviation above 0, and --resume, got {arguments.widen:g}")
    from np_training.tasks.registry import find_task  # slow: no --help should wait for PyTorch

    task, arguments.device = find_task(arguments.domain), usable(arguments.device)
    try:
        arguments.effects = load_effects(arguments.effects)
        arguments.played = played_domain(
            arguments.domain, arguments.object, arguments.max_opening, arguments.largest_turn
        )
        arguments.reward = reward_for(
            arguments.reward,
            task.far,
            far=arguments.far,
            turn=arguments.turn,
            bare=arguments.bare,
            change=arguments.change,
            hidden=arguments.hidden,
        )
    except ValueError as error:
        parser.error(str(error))
    arguments.contact = arguments.contact or LEARNED_IN[task.domain.contact.name]
    if arguments.tolerance is None:
        arguments.tolerance = task.domain.aim
    arguments.out = arguments.out or Path("runs") / arguments.domain
    for name in ("limit", "practice", "explore"):
        if getattr(arguments, name) is None:
            setattr(arguments, name, getattr(task, name))
    return arguments


def played_domain(
    name: str, choice: str = DEFAULT, max_opening: float | None = None, turn: float | None = None
) -> Domain:
    """The domain with the object chosen, fingers that open up to max_opening m each and turns of up to `turn` rad (None: the domain's own).

    Raises ValueError, one line, for an object that the domain has not or that cannot be trained with, and for another opening or turn.
    """
    opening = find_domain(name).max_opening if max_opening is None else max_opening
    if not 0 <= opening <= FINGER_MAX:
        raise ValueError(f"max_opening: expected 0 to {FINGER_MAX} m, got {opening:g}")
    turned = {} if turn is None else {"largest_turn": turn}
    return domain_of({"domain": name, "object": choice, "max_opening": opening, **turned})


def reward_for(name: str, task_far: float, **weights: float | None) -> RewardConfig | PaperReward:
    """The reward called `name`; weights: of potentials, None for the default one, which is task_far for `far`.

    Raises ValueError where potentials are weighed for a reward that has none.
    """
    given = {key: value for key, value in weights.items() if value is not None}
    if name == RewardConfig.name:
        return RewardConfig(**{"far": task_far, **given})
    if given:
        raise ValueError(
            f"{', '.join(given)}: expected --reward {RewardConfig.name}, whose weights these are, got {name}"
        )
    return PaperReward()

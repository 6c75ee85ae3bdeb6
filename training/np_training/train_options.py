"""The options of `np_training.train` and their defaults."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS, Task, find_domain
from np_description.objects.choice import DEFAULT
from np_description.panda import FINGER_MAX
from np_training.device import DEVICE_HELP, usable
from np_training.options import count, duration
from np_training.physics.config import STEPPING
from np_training.physics.supported_effects import load_effects
from np_training.ppo.curriculum import STAGES
from np_training.recipe import Recipe, RecipeError, Settings, read_recipe, settings_of
from np_training.setting import OBJECT_HELP, domain_of
from np_training.tasks.randomisation import CONDITIONS, parse_changes

CHECKPOINT = "checkpoint.pt"  # in the folder of a run


def parse() -> argparse.Namespace:
    """The command line; `stages`: the settings of each, from the recipe or of the one stage that options describe."""
    parser = Parser(description="Joint training of the pre- and post-contact policies.")
    parser.add_argument("--recipe", type=Path, help="a file of recipes/: domain and settings of every stage")
    parser.add_argument("--domain", choices=list(DOMAINS), help="without a recipe; default: card")
    parser.add_argument("--object", default=DEFAULT, help=OBJECT_HELP)
    parser.add_argument("--out", type=Path, help="default: runs/DOMAIN")
    parser.add_argument("--resume", type=Path, help="checkpoint to start from; default: OUT/checkpoint.pt, if any")
    parser.add_argument(
        "--stage", type=int, help=f"of the curriculum, at which what is resumed begins again (0 to {STAGES})"
    )
    parser.add_argument("--minutes", type=duration, help="at most, of this call; default: 20 without a recipe")
    parser.add_argument(
        "--from-first", action="store_true", help="count minutes from the end of the first iteration, which compiles"
    )
    parser.add_argument("--iterations", type=count, default=10**9, help="at most, of this call")
    parser.add_argument("--save-every", type=float, default=120.0, help="seconds between checkpoints")
    parser.add_argument(
        "--show-every", type=float, default=60.0, help="seconds between lines where there is no terminal"
    )
    parser.add_argument("--worlds", type=count, default=24576, help="of all processes together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", help=DEVICE_HELP)
    parser.add_argument(
        "--effects", type=Path, help="patch.yaml of the diagnosis: what the arm has besides the nominal one"
    )
    parser.add_argument("--contact", choices=list(STEPPING), help="see np_description.contact; default: the domain's")
    parser.add_argument("--conditions", choices=list(CONDITIONS)[1:], help="what is randomised at the end")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="FIELD=VALUE",
        help="settings of np_training.recipe, of every stage: --set hold=5 'reward={\"hidden\": 20}'",
    )
    arguments = parser.parse_args()
    if arguments.recipe and arguments.domain:
        parser.error("--domain: a recipe has its own")
    if arguments.worlds % (processes := int(os.environ.get("WORLD_SIZE", 1))):  # of torchrun
        parser.error(f"--worlds: expected a multiple of the {processes} processes, got {arguments.worlds}")
    arguments.device = usable(arguments.device)
    try:
        changes = parse_changes(arguments.set)
        changes |= {name: getattr(arguments, name) for name in ("contact", "conditions") if getattr(arguments, name)}
        recipe = (
            read_recipe(arguments.recipe, changes)
            if arguments.recipe
            else Recipe(arguments.domain or "card", (settings_of(changes),))
        )
        arguments.effects = load_effects(arguments.effects)
        arguments.stages = tuple(_complete(recipe.domain, stage) for stage in recipe.stages)
        for stage in arguments.stages:
            choose_played_domain(recipe.domain, arguments.object, stage)
    except (ValueError, RecipeError) as error:
        parser.error(str(error))
    arguments.domain = recipe.domain
    arguments.out = arguments.out or Path("runs") / recipe.domain
    if arguments.minutes is None:
        arguments.minutes = float("inf") if arguments.recipe else 20.0
    return arguments


def _complete(name: str, settings: Settings) -> Settings:
    """Settings with the task's own values where they have none."""
    from np_training.physics.config import LEARNED_IN
    from np_training.tasks.registry import find_task  # slow: no --help should wait for PyTorch

    task = find_task(name)
    own = {
        field: getattr(task, field) for field in ("limit", "practice", "explore") if getattr(settings, field) is None
    }
    if settings.tolerance is None:
        own["tolerance"] = task.domain.tolerance_fraction
    if settings.contact is None:
        own["contact"] = LEARNED_IN[task.domain.contact.name]
    return replace(settings, reward={"far": task.far, **settings.reward}, **own)


def choose_played_domain(name: str, object_ref: str, settings: Settings) -> Task:
    """The domain with the object chosen, and opening and turns of the settings (None: the domain's own).

    Raises ValueError, one line, for an object that the domain has not or that cannot be trained with, and for another opening or turn.
    """
    opening = find_domain(name).max_opening if settings.max_opening is None else settings.max_opening
    if not 0 <= opening <= FINGER_MAX:
        raise ValueError(f"max_opening: expected 0 to {FINGER_MAX} m, got {opening:g}")
    turned = {} if settings.largest_turn is None else {"largest_turn": settings.largest_turn}
    return domain_of({"domain": name, "object": object_ref, "max_opening": opening, **turned})

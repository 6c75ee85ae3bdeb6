"""The settings of the training that a checkpoint holds: evaluation, distillation and release have to use the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from np_control.impedance import DAMPING_RATIO_MIN
from np_description.domains import Task, find_domain
from np_description.objects.choice import DEFAULT, domain_with, embed_object_text
from np_training.physics.config import check_trainable

UNSAID = {
    "domain": "card",
    "object": DEFAULT,
    "limit": 100,
    "contact": "soft",
    "damping_floor": DAMPING_RATIO_MIN,
}
"""Defaults for checkpoints that do not hold them: those of the first versions."""
SETTING = (*UNSAID, "max_opening", "largest_turn")
"""What a training shares with distillation, evaluation and release. damping_floor: least damping ratio of an action."""
WEIGHTS, RESULTS = Path("weights"), Path("docs/results")  # where a release goes
OBJECT_HELP = "a rigid row of the domain's table of objects, or a .yaml file"


def setting_of(state: Mapping[str, object]) -> dict:
    """The whole setting of a checkpoint, by name. max_opening: of one finger, m, at a pre-contact action of 1; largest_turn: from start to goal, rad."""
    setting = UNSAID | state.get("setting", {})
    domain = find_domain(setting["domain"])
    setting = {"max_opening": domain.max_opening, "largest_turn": largest_turn(domain), **setting}
    return {name: value for name, value in setting.items() if name in SETTING}


def largest_turn(domain: Task) -> float | None:
    """The largest turn rad from start to goal that a domain draws; None where the goal does not go by the start."""
    return None if domain.goal_yaw is None else domain.goal_yaw[1]


def chosen(setting: Mapping[str, object], **given: object) -> dict:
    """The setting with what a command line gives (None: nothing), an object as it means the same elsewhere.

    Raises ValueError, one line, for an object that the domain has not.
    """
    setting = {**setting, **{name: value for name, value in given.items() if value is not None}}
    return {**setting, "object": embed_object_text(setting["domain"], setting["object"])}


def domain_of(setting: Mapping[str, object]) -> Task:
    """The domain of a setting, with its object, opening and turns.

    Raises ValueError, one line, for an object that the domain has not, or that training cannot move, and for turns of a
    domain whose goals do not go by the start.
    """
    domain = domain_with(setting["domain"], setting["object"])
    check_trainable(domain)
    turn = setting.get("largest_turn", largest_turn(domain))
    opened = replace(domain, max_opening=setting["max_opening"])
    if domain.goal_yaw is not None:
        return replace(opened, goal_yaw=(-turn, turn))
    if turn is not None:
        raise ValueError(f"largest_turn: expected none for {domain.name}, got {turn:g}")
    return opened

"""All effects, found by where they lie: sim2real.effects/MODULE/ID.py with `EFFECT` in it. A new file is a new effect.

Effects of one's own lie in folders named by the environment variable NP_EFFECTS_PATH (several with ":" between), one file an
effect likewise, with its row of the catalogue (`Effect.catalogue_row`). Their former name `RECORD` is read for one release.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.resources import files
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import MappingProxyType

from sim2real.effects.catalogue import ROW, catalogue
from sim2real.effects.effect import ARM_TARGETS, CAMERA_TARGETS, SCENE_TARGETS, Effect
from sim2real.effects.evidence import Context
from sim2real.effects.regressor import EffectRegressor

FOLDERS = "NP_EFFECTS_PATH"
MODULES = ("joint_dynamics", "transmission", "torque_loop", "software", "timing", "rigid_body", "sensing")
"""Modules of effects of the arm, in the order in which the diagnosis tries them."""


def find_effects(targets: tuple[str, ...], modules: tuple[str, ...] = (), folders: str = "") -> Mapping[str, Effect]:
    """The project's own effects of these targets by id, then those in `folders` (paths with ":" between).

    modules: where they lie; none: in modules with the targets' names. Raises ImportError for a file that holds no effect, or
    not the one of its name and folder.
    """
    found, modules = {}, modules or tuple(map(str, targets))
    for place, module, effect in (*_load_own_effects(modules), *_load_user_effects(folders)):
        row = effect.catalogue_row or catalogue().get(effect.id)
        if (
            row is None
            or set(row) - {"id"} != set(ROW)
            or row["module"] not in modules
            or module not in ("", row["module"])
        ):
            raise ImportError(
                f"{place}: expected a row of the catalogue with {', '.join(ROW)} and the module "
                f"{module or ' or '.join(modules)}, in data/gap_effects.yaml or as catalogue_row; got {row}"
            )
        if effect.id != Path(place).stem or effect.id in found or effect.target not in targets:
            raise ImportError(
                f"{place}: expected the effect {Path(place).stem!r} of {' or '.join(targets)}, once; got {effect.id!r} of "
                f"{effect.target}"
            )
        found[effect.id] = effect
    return MappingProxyType(found)


def find_arm_effects(folders: str = "") -> Mapping[str, Effect]:
    """Effects of the arm, those in `folders` included (`find_effects`)."""
    return find_effects(ARM_TARGETS, MODULES, folders)


def _load_own_effects(modules: tuple[str, ...]) -> Iterator[tuple[str, str, Effect]]:
    for module in modules:
        for file in sorted(entry.name for entry in (files("sim2real.effects") / module).iterdir()):
            if file.endswith(".py") and not file.startswith("_"):
                name = f"sim2real.effects.{module}.{file.removesuffix('.py')}"
                yield f"sim2real.effects/{module}/{file}", module, import_module(name).EFFECT


def _load_user_effects(folders: str) -> Iterator[tuple[str, str, Effect]]:
    for folder in filter(None, folders.split(":")):
        if not Path(folder).is_dir():
            raise ImportError(f"{FOLDERS}: expected folders with a file an effect, got {folder!r}, which is none")
        for path in sorted(Path(folder).glob("*.py")):
            spec = spec_from_file_location(f"np_effects_path.{path.stem}", path)
            module = module_from_spec(spec)
            spec.loader.exec_module(module)
            effect = getattr(module, "EFFECT", None) or getattr(module, "RECORD", None)
            if not isinstance(effect, Effect):
                raise ImportError(f"{path}: expected a sim2real.effects.effect.Effect called EFFECT")
            yield str(path), "", effect


try:
    ARM_EFFECTS = find_arm_effects(os.environ.get(FOLDERS, ""))
except ImportError as error:
    if not os.environ.get(FOLDERS):
        raise
    raise SystemExit(str(error)) from None  # the user's setting, not a fault of this code: one line in every command
"""Effects of the arm that the simulators or the diagnosis contain, by id."""

CAMERA_EFFECTS = find_effects(CAMERA_TARGETS)
"""Effects of camera and keypoints that a simulated camera carries, by id."""

SCENE_EFFECTS = find_effects(SCENE_TARGETS)
"""Effects of contact, object and table that a simulated scene carries, by id."""

EFFECTS = MappingProxyType({**ARM_EFFECTS, **CAMERA_EFFECTS, **SCENE_EFFECTS})
"""All of them."""


def make_regressors(context: Context) -> list[EffectRegressor]:
    """Every way in which an effect could show in this recording, variants included."""
    return [one for effect in ARM_EFFECTS.values() for one in effect.regressors(context)]


def make_reference_regressors(context: Context) -> list[EffectRegressor]:
    """What the earlier recordings of the arm already show of the effects that have `Effect.reference_regressors`."""
    return [
        one
        for effect in ARM_EFFECTS.values()
        if effect.reference_regressors
        for one in effect.reference_regressors(context)
    ]

"""All records, found by where they lie: sim2real.effects/MODULE/ID.py with `RECORD` in it. A new file is a new effect.

Effects of one's own lie in folders named by the environment variable NP_EFFECTS_PATH (several with ":" between), one file an
effect likewise; such a record brings its row of the catalogue along (`EffectRecord.text`).
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
from sim2real.effects.evidence import Context
from sim2real.effects.record import EffectRecord
from sim2real.effects.scene_record import SceneRecord, Whose
from sim2real.effects.signature import Signature
from sim2real.effects.view_record import Part, ViewRecord

FOLDERS = "NP_EFFECTS_PATH"
# In the order in which the doctor tries them.
MODULES = ("joint_dynamics", "transmission", "torque_loop", "software", "timing", "rigid_body", "sensing")
VIEW_MODULES = tuple(map(str, Part))
SCENE_MODULES = tuple(map(str, Whose))


def find_records(folders: str = "") -> Mapping[str, EffectRecord]:
    """The project's own records by id, then those in `folders` (paths with ":" between).

    Raises ImportError for a file that holds no record, or another one than its name and place say.
    """
    found = {}
    for place, module, record in (*_own(MODULES), *_of(folders)):
        row = record.text or catalogue().get(record.id)
        if (
            row is None
            or set(row) - {"id"} != set(ROW)
            or row["module"] not in MODULES
            or module not in ("", row["module"])
        ):
            raise ImportError(
                f"{place}: expected a row of the catalogue with {', '.join(ROW)} and the module "
                f"{module or ' or '.join(MODULES)}, in data/gap_effects.yaml or as the record's text; got {row}"
            )
        if record.id != Path(place).stem or record.id in found:
            raise ImportError(f"{place}: expected the record of {Path(place).stem!r}, once; got {record.id!r}")
        found[record.id] = record
    return MappingProxyType(found)


def find_view_records() -> Mapping[str, ViewRecord]:
    """The records of what may be wrong with camera and keypoints, by id. Raises ImportError as `find_records` does."""
    return _parts(VIEW_MODULES)


def find_scene_records() -> Mapping[str, SceneRecord]:
    """The records of what may be wrong with contact, object and table, by id. Raises ImportError as `find_records` does."""
    return _parts(SCENE_MODULES)


def _parts(modules: tuple[str, ...]) -> Mapping[str, ViewRecord | SceneRecord]:
    found = {}
    for place, module, record in _own(modules):
        row = catalogue().get(record.id)
        if row is None or row["module"] != module or record.part != module or record.id != Path(place).stem:
            raise ImportError(
                f"{place}: expected the record of {Path(place).stem!r} of the {module}, got {record.id!r}"
            )
        found[record.id] = record
    return MappingProxyType(found)


def _own(modules: tuple[str, ...]) -> Iterator[tuple[str, str, EffectRecord | ViewRecord | SceneRecord]]:
    for module in modules:
        for file in sorted(entry.name for entry in (files("sim2real.effects") / module).iterdir()):
            if file.endswith(".py") and not file.startswith("_"):
                name = f"sim2real.effects.{module}.{file.removesuffix('.py')}"
                yield f"sim2real.effects/{module}/{file}", module, import_module(name).RECORD


def _of(folders: str) -> Iterator[tuple[str, str, EffectRecord]]:
    for folder in filter(None, folders.split(":")):
        if not Path(folder).is_dir():
            raise ImportError(f"{FOLDERS}: expected folders with a file an effect, got {folder!r}, which is none")
        for path in sorted(Path(folder).glob("*.py")):
            spec = spec_from_file_location(f"np_effects_path.{path.stem}", path)
            module = module_from_spec(spec)
            spec.loader.exec_module(module)
            if not isinstance(getattr(module, "RECORD", None), EffectRecord):
                raise ImportError(f"{path}: expected an sim2real.effects.record.EffectRecord called RECORD")
            yield str(path), "", module.RECORD


RECORDS = find_records(os.environ.get(FOLDERS, ""))
"""Every effect of the arm that the simulators or the doctor know, by id."""

VIEW_RECORDS = find_view_records()
"""Every effect of camera and keypoints that a simulated view carries, by id."""

SCENE_RECORDS = find_scene_records()
"""Every effect of contact, object and table that a simulated scene carries, by id."""


def all_signatures(context: Context) -> list[Signature]:
    """Every way in which an effect could show in this recording, variants included."""
    return [signature for record in RECORDS.values() for signature in record.signatures(context)]


def shown_before(context: Context) -> list[Signature]:
    """What the recordings of the arm as it was show of effects that settle it there (`EffectRecord.always`)."""
    return [signature for record in RECORDS.values() if record.always for signature in record.always(context)]

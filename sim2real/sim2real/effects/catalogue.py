"""The catalogue: what is known of each effect in words, whether or not there is a record of it yet."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import yaml

ROW = ("module", "model", "panda_magnitude", "signature", "exciting_experiment")


@cache
def catalogue() -> dict[str, dict]:
    """Rows of data/gap_effects.yaml by id: module, model, panda_magnitude, signature, exciting_experiment."""
    return {entry["id"]: entry for entry in _data()["effects"]}


@cache
def equivalence_classes() -> tuple[tuple[frozenset[str], str], ...]:
    """Ids that one data set may not distinguish, and the experiment that does."""
    return tuple((frozenset(entry["members"]), entry["split_by"]) for entry in _data()["equivalence_classes"])


@cache
def _data() -> dict:
    return yaml.safe_load((files("sim2real.effects") / "data" / "gap_effects.yaml").read_text(encoding="utf-8"))

"""The key of a set of arms: what every case is, known from (cases, seed, set) alone."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from np_blind.arm.sampling.cases import draw_cases, magnitude, make_physics
from np_blind.arm.sampling.faults import Fault
from np_blind.sealed import KEYS, SCHEMA, commit_hash


def seal(count: int, seed: int, which: str, only: Sequence[str] = (), path: Path = KEYS) -> str:
    """Put down the hash of an arm's set, once; the hash. Raises SealError where another one stands there."""
    return commit_hash(make_key(count, seed, which, only), path)


def make_key(count: int, seed: int, which: str, only: Sequence[str] = ()) -> str:
    """The key as JSON text: of each case its kind, faults, sizes and parameters.

    only: the part of the suite that is recorded; it stands in the key where it is not the whole.
    """
    cases = draw_cases(count, seed, which)
    _, truths = make_physics(cases)
    entries = [
        {
            "case": case.number,
            "kind": case.kind,
            "faults": [
                {
                    **_fault(fault),
                    "parameters": {
                        name: {"value": _rounded(value), "unit": unit} for name, (value, unit) in given.items()
                    },
                }
                for fault, given in zip(case.faults, truth)
            ],
            **({"always": [_fault(fault) for fault in case.always]} if case.day else {}),
        }
        for case, truth in zip(cases, truths)
    ]
    part = {"only": list(only)} if only else {}
    key = {"schema": SCHEMA, "set": which, "seed": seed, "cases": entries, **part}
    return json.dumps(key, indent=1, sort_keys=True) + "\n"


def _fault(fault: Fault) -> dict:
    return {
        **asdict(fault),
        "size": _rounded(fault.size),
        "component": fault.component,
        "magnitude": _rounded(magnitude(fault)),
    }


def _rounded(value: float | None) -> float | None:
    """Nine digits: the last ones may differ between machines."""
    return None if value is None else float(f"{value:.9g}")

"""Sealed keys: the SHA-256 of all cases of a set, committed beforehand, and of the diagnosis that is evaluated.

A key needs no simulation: its hash is committed before any recording exists, and anyone can draw the same key again.
"""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path

KEYS = Path(str(files("np_blind") / "data" / "keys.txt"))
"""Committed: one line a sealed key, `set cases seed sha256`."""
SCHEMA = 1


class SealError(ValueError):
    """A key whose hash is not the committed one; the message gives what was expected and what came."""


def digest(key: str) -> str:
    """SHA-256 (hex) of a key."""
    return hashlib.sha256(key.encode()).hexdigest()


def commit_hash(key: str, path: Path = KEYS) -> str:
    """Write the hash of a key once; the hash. Raises SealError where another one stands there."""
    name, found = _name(key), digest(key)
    known = _known(path).get(name)
    if known is None:
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{' '.join(map(str, name))} {found}\n")
    elif known != found:
        raise SealError(_mismatch(path, *name, known, found))
    return found


def check_hash(key: str, path: Path = KEYS) -> str:
    """The hash of a key, which must be the committed one. Raises SealError."""
    name, found = _name(key), digest(key)
    known = _known(path).get(name)
    if known is None:
        raise SealError(
            f"{path}: expected the hash of key {' '.join(map(str, name))}, put down (--seal) and "
            "committed before the diagnosis runs; it is not there"
        )
    if known != found:
        raise SealError(_mismatch(path, *name, known, found))
    return found


def check_diagnosis_code(out: Path, is_locked: bool) -> str:
    """SHA-256 over the code of sim2real, written to `out` by the first call.

    Raises SealError where `out` of a locked set holds reports of other code.
    """
    code = hashlib.sha256()
    for package in ("sim2real",):
        root = Path(str(files(package)))
        for path in sorted(root.rglob("*.py")):
            code.update(path.relative_to(root.parent).as_posix().encode() + path.read_bytes())
    found, note = code.hexdigest(), out / "diagnosis.sha256"
    known = note.read_text().strip() if note.exists() else found
    if is_locked and known != found:
        raise SealError(
            f"{out}: expected the diagnosis with SHA-256 {known} that gave the answers there, got {found}: "
            "its code has changed since; name another --out"
        )
    note.write_text(found + "\n")
    return found


def _name(key: str) -> tuple[str, int, int]:
    """Set, number of cases and seed of a key."""
    raw = json.loads(key)
    return raw["set"], len(raw["cases"]), raw["seed"]


def _known(path: Path) -> dict[tuple[str, int, int], str]:
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    rows = (line.split() for line in lines if line.strip() and not line.startswith("#"))
    return {(which, int(count), int(seed)): found for which, count, seed, found in rows}


def _mismatch(path: Path, which: str, count: int, seed: int, known: str, found: str) -> str:
    return (
        f"{path}: key {which} {count} {seed}: expected SHA-256 {known}, got {found}: "
        "the generator, or --only, is not that of the sealed key"
    )

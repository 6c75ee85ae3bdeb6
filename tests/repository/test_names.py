"""Public names are the field's: no words of a private dialect, and no class name that means two things."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache

import pytest
from packages import modules

WORDS = {
    "alike",
    "apart",
    "asked",
    "asking",
    "astray",
    "believed",
    "beside",
    "carried",
    "doubt",
    "drawn",
    "felt",
    "given",
    "kept",
    "lain",
    "led",
    "met",
    "rehearsal",
    "rehearse",
    "rested",
    "said",
    "seen",
    "settled",
    "strange",
    "stranger",
    "swayed",
    "telling",
    "told",
    "unseen",
    "way",
    "whole",
}
"""Words, between underscores or capitals, that no public function or class has in its name."""


@cache
def definitions() -> list[tuple[str, ast.FunctionDef | ast.ClassDef]]:
    """Public functions and classes at the top of installed modules, with their modules."""
    found = []
    for module, path in modules().items():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                found.append((module, node))
    return found


def words(name: str) -> set[str]:
    """The words of a name in snake case or camel case."""
    spaced = "".join(f"_{c.lower()}" if c.isupper() else c for c in name)
    return set(spaced.split("_"))


def is_participle(name: str) -> bool:
    """Whether a whole name is one past participle."""
    return name.endswith("ed") and "_" not in name and name not in ("speed", "seed", "feed")


def unclear() -> set[str]:
    """Names with a word of WORDS, and functions called by a participle alone."""
    return {
        f"{module}.{node.name}"
        for module, node in definitions()
        if words(node.name) & WORDS or (isinstance(node, ast.FunctionDef) and is_participle(node.name))
    }


def shared() -> set[str]:
    """Class names that several modules define."""
    places = defaultdict(set)
    for module, node in definitions():
        if isinstance(node, ast.ClassDef):
            places[node.name].add(module)
    return {name for name, where in places.items() if len(where) > 1}


def test_public_names_use_no_word_of_the_list():
    assert unclear() == set()


def test_a_class_name_is_defined_once():
    assert shared() == set()


@pytest.mark.parametrize("name, found", [("settled", True), ("run_seen_by", True), ("TaskDiagnosis", False)])
def test_the_words_of_a_name_are_found(name, found):
    assert bool(words(name) & WORDS) is found


if __name__ == "__main__":
    print("\n".join(sorted(unclear())), sorted(shared()), sep="\n")

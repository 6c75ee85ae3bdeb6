"""Every number by which the doctor decides says what it is, in which unit, and where it comes from."""

from dataclasses import FrozenInstanceError, dataclass, field, fields

import pytest
from sim2real.thresholds import THRESHOLDS
from sim2real.thresholds.entry import entries, table, threshold


def test_every_threshold_has_unit_meaning_and_source():
    found = list(entries(THRESHOLDS))
    assert len(found) == sum(len(fields(getattr(THRESHOLDS, group.name))) for group in fields(THRESHOLDS))
    for entry in found:
        assert entry.unit and entry.meaning and entry.source, entry.name
        values = entry.value if isinstance(entry.value, tuple) else (entry.value,)
        assert values and all(isinstance(value, (int, float)) for value in values), entry.name


def test_a_threshold_without_a_source_is_found():
    @dataclass(frozen=True)
    class Bare:
        known: float = threshold(1.0, "s", "a time", "measured")
        bare: float = field(default=2.0)

    with pytest.raises(ValueError, match="threshold bare: expected unit, meaning and source, got no unit"):
        list(entries(Bare()))


def test_the_table_of_the_documentation_has_a_row_for_each():
    rows = table(THRESHOLDS).splitlines()
    assert len(rows) == 2 + len(list(entries(THRESHOLDS)))
    assert all(row.count(" | ") == 4 for row in rows if not row.startswith("|---"))
    (row,) = (row for row in rows if row.startswith("| `search.sure_gain` |"))
    assert row.split(" | ")[1:3] == ["40", "nats"]


def test_thresholds_do_not_change():
    with pytest.raises(FrozenInstanceError):
        THRESHOLDS.search.gain = 0.0

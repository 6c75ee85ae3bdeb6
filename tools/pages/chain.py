"""Results of the doctor beside the arm: clocks of two streams of poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from pages.markdown import table

SYNTHETIC = (
    "motion",
    "draws",
    "undetermined",
    "intervals that hold",
    "error, ms",
    "half width, ms",
    "drift: hold",
    "error, ppm",
    "half width, ppm",
)
REAL = (
    "recording",
    "frames",
    "verdicts",
    "offsets",
    "within 5 ms",
    "largest error, ms",
    "half width, ms",
    "intervals that hold",
)


def clock(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.clocks`."""
    synthetic, real = data["synthetic"], data["real"]
    told, kept = _told(synthetic), _told(real)
    near = sum(abs(row["error_s"]) < 5e-3 for row in kept)
    shifts = sum("shift_s" in row and row["shift_s"] != 0 for row in real)
    headline = (
        f"{_share(told, 'holds')} of 95 % intervals hold, drift {_share(told, 'drift_holds')}; "
        f"shifts of real stamps within 5 ms: {near} of {shifts}"
    )
    body = "## Synthetic recordings\n\n" + table(SYNTHETIC, _synthetic(synthetic)) + "\n" + _named(told)
    body += "\n## As they were published\n\n" + table(
        ("recording", "offset, ms", "drift, ppm", "verdict", "doubt"), [_published(r) for r in real if not r["shift_s"]]
    )
    body += (
        "\n## Stamps shifted by 20, 40, 60 and 80 ms to either side\n\nErrors are those of the difference to the offset of the "
        "recording as it was published.\n\n" + table(REAL, _real([row for row in real if row["shift_s"]]))
    )
    return headline, body


def _told(rows: Iterable[Mapping]) -> list[Mapping]:
    return [row for row in rows if "holds" in row]


def _share(rows: list[Mapping], key: str) -> str:
    return f"{np.mean([row[key] for row in rows]):.3f}" if rows else "none"


def _root(rows: list[Mapping], key: str) -> float:
    return float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))


def _median(rows: list[Mapping], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _synthetic(rows: list[Mapping]) -> Iterable[tuple]:
    for name in [*dict.fromkeys(row["rig"] for row in rows), "all"]:
        mine = [row for row in rows if name in ("all", row["rig"])]
        told = _told(mine)
        yield (
            name, len(mine), len(mine) - len(told), _share(told, "holds"), 1e3 * _root(told, "error_s"),
            1e3 * _median(told, "half_width_s"), _share(told, "drift_holds"), _root(told, "drift_error_ppm"),
            _median(told, "drift_half_width_ppm"),
        )  # fmt: skip


def _named(rows: list[Mapping]) -> str:
    parts = []
    for drift in sorted({row["drift_ppm"] for row in rows}):
        mine = [row for row in rows if row["drift_ppm"] == drift]
        parts.append(f"{drift:.0f} ppm in {sum(row['drift_named'] for row in mine)} of {len(mine)}")
    return f"A drift is named: {', '.join(parts)}. Errors are root mean squares, half widths medians.\n"


def _published(row: Mapping) -> tuple:
    if "offset_s" not in row:
        return row["recording"], None, None, row["verdict"], row["doubt"]
    return (
        row["recording"],
        f"{1e3 * row['offset_s']:.1f} +- {1e3 * row['half_width_s']:.1f}",
        f"{row['drift_ppm']:.0f} +- {row['drift_half_width_ppm']:.0f}",
        row["verdict"],
        row["doubt"],
    )


def _real(rows: list[Mapping]) -> Iterable[tuple]:
    for recording, condition in dict.fromkeys((row["recording"], row["condition"]) for row in rows):
        mine = [row for row in rows if (row["recording"], row["condition"]) == (recording, condition)]
        told, verdicts = _told(mine), [row["verdict"] for row in mine]
        counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
        errors = [1e3 * abs(row["error_s"]) for row in told]
        yield (
            recording, condition, counts, f"{len(told)} of {len(mine)}", f"{sum(e < 5 for e in errors)} of {len(mine)}",
            max(errors, default=None), 1e3 * _median(told, "half_width_s") if told else None, _share(told, "holds"),
        )  # fmt: skip

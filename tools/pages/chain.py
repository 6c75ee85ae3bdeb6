"""Results of the doctor beside the arm: clocks of two streams of poses, and the blind set of the task suite."""

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


QUANTITIES = {"table": 1.0, "finger": 1.0, "mass": 1e3, "height": 1e3, "late": 1e3, "picture_x": 1e3, "picture_y": 1e3}
UNITS = {
    "table": "friction, table",
    "finger": "friction, fingertip",
    "mass": "mass, g",
    "height": "table, mm",
    "late": "late, ms",
    "picture_x": "picture x, mm",
    "picture_y": "picture y, mm",
}


def task(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.chain.set`."""
    rows, found = data["rows"], data["figures"]
    part = "" if len(rows) == data["drawn"] else f"; {data['drawn'] - len(rows)} have not been run"
    shown = (
        "right effect or class",
        "right effect or class, singles",
        "false alarm, clean",
        "95 % intervals that hold",
    )
    headline = f"{len(rows)} of {data['drawn']} cases{part}: " + ", ".join(
        f"{name} {found[name]['value']:.2f} of {found[name]['of']}" for name in shown if name in found
    )
    figures = ((n, f["value"], "{:.2f} to {:.2f}".format(*f["ci95"]), f["of"]) for n, f in found.items())
    body = table(("figure", "share", "95 %", "of"), figures)
    body += f"\nSHA-256 of the key `{data['key_sha256'][:16]}`, of the doctor `{data['doctor_sha256'][:16]}`.\n\n## Every case\n\n"
    body += table(("case", "what is other", "verdict", "said", "right"), (_case(row) for row in rows))
    body += "\n## Every number that was measured\n\nWith its 95 % interval; the truth has the background in it.\n\n"
    units = {n: u for n, u in UNITS.items() if any(n in row.get("intervals", {}) for row in rows)}
    body += table(("case", *units.values()), (_numbers(row, units) for row in rows if "intervals" in row))
    moved = [row for row in rows if (row.get("motion") or {}).get("windows")]
    return headline, body + _motion(moved) if moved else body


def _motion(rows: list[Mapping]) -> str:
    """Of sets that have a recording which no stage heard."""
    head = (
        "case",
        "windows",
        "as believed, px",
        "with the patch",
        "with all that is true",
        "everything at once",
        "removed, 95 %",
    )
    cells = (
        (
            row["case"],
            row["motion"]["windows"],
            *(row["motion"][name] for name in ("believed", "patch", "truth", "at_once")),
            "{:.2f}, {:.2f} to {:.2f}".format(*row["motion"]["removed"]),
        )
        for row in rows
    )
    return (
        "\n## The object's motion, held out\n\nCorners in drags, pushes and taps of a recording that no stage heard, px off their prediction "
        "in MuJoCo, mean over windows.\n\n" + table(head, cells)
    )


def _case(row: Mapping) -> tuple:
    # Of the first set a gap is the parameters of its one effect, which the kind names.
    gaps = row["gap"] if all(isinstance(one, Mapping) for one in row["gap"].values()) else {row["kind"]: row["gap"]}
    what = (
        "; ".join(f"{e}: " + ", ".join(f"{n} {v:.3g}" for n, v in of.items()) for e, of in gaps.items()) or row["kind"]
    )
    if row.get("error"):
        return row["case"], what, "error", row["error"].strip().splitlines()[-1], "no"
    said = "; ".join([*row["said"], *(row["doubts"].values() if row["unexplained"] else ())]) or "nothing"
    if row["module"] is not None:
        right = row["effect"] and not row["wrong"]
    else:
        right = not row["named"] and row["unexplained"] == (row["kind"] != "clean")
    return row["case"], what, row["verdict"].replace("_", " "), said, "yes" if right else "no"


def _numbers(row: Mapping, units: Mapping) -> tuple:
    return row["case"], *(_number(row["intervals"].get(name), QUANTITIES[name]) for name in units)


def _number(one: Mapping | None, scale: float) -> str:
    if one is None:
        return ""
    value, low, high, true = (scale * one[key] for key in ("value", "low", "high", "true"))
    return f"{value:.3g}, {low:.3g} to {high:.3g} ({true:.3g}{'' if one['holds'] else ': missed'})"


def clock(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.camera.clocks`."""
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

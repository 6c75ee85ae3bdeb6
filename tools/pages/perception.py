"""Results of what sees: detectors, their ablations, calibration of the camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pages.markdown import table

HEADER = ("set", "images", "visible: median, px", "95 %", "within 3 px", "hidden: median, px", "95 %", "within 3 px")


def _rows(sets: Mapping) -> Iterator[tuple]:
    for name, of in sets.items():
        errors = [of[kind][key] for kind in ("visible", "hidden") for key in ("median", "p95", "within")]
        yield name, of["images"], *errors, of["calibration_error"]


def detector(data: Mapping) -> tuple[str, str]:
    """Headline and body of a detector on held-out images."""
    name = "shifted" if "shifted" in data["sets"] else list(data["sets"])[-1]
    headline = f"{name} images, medians: " + ", ".join(
        f"{kind} {data['sets'][name][kind]['median']:.2f} px" for kind in ("visible", "hidden")
    )
    body = table((*HEADER, "calibration error"), _rows(data["sets"]))
    if timing := data.get("detection"):
        body += _times(timing)
    return headline, body


def _times(timing: Mapping) -> str:
    text = f"\nOne image: {timing['p50_ms']:.1f} ms in the median, {timing['p95_ms']:.1f} ms at 95 %; "
    return text + f"{timing['peer']}: {timing['peer_p50_ms']:.1f} and {timing['peer_p95_ms']:.1f} ms.\n"


def ablation(data: Mapping) -> tuple[str, str]:
    """Headline and body of detectors trained with and without a part."""
    rows = [
        (name, run["steps"], run.get("minutes"), *row)
        for name, run in data["runs"].items()
        for row in _rows(run["sets"])
    ]
    return "three short runs", table(("run", "steps", "minutes", *HEADER, "calibration error"), rows)


def by_row(data: Mapping) -> tuple[str, str]:
    """Headline and body of detectors on every row of the table of objects, along played episodes."""
    header = (
        "domain",
        "object",
        "images",
        "all corners: median, px",
        "95 %",
        "sure",
        "sure ones: median, px",
        "95 %",
        "within 3 px",
    )
    keys = ("images", "median_px", "q95_px", "sure", "sure_median_px", "sure_q95_px", "sure_within_3_px")
    worst = min(data["rows"], key=lambda row: row["sure_within_3_px"])
    headline = f"{len(data['rows'])} objects; least within 3 px: {worst['domain']} {worst['object']}, {worst['sure_within_3_px']:.2f}"
    return headline, table(
        header, ((row["domain"], f"`{row['object']}`", *(row[key] for key in keys)) for row in data["rows"])
    )


def calibration(data: Mapping) -> tuple[str, str]:
    """Headline and body of the calibration trial."""
    figures = (
        ("position error, mm", "error_mm"),
        ("rotation error, degrees", "error_deg"),
        ("card's corners, mean, px", "keypoint_mean_px"),
        ("worst corner, px", "keypoint_max_px"),
        ("card's place, mean, mm", "object_mean_mm"),
        ("table's height, mm", "table_error_mm"),
    )
    rows = []
    for name, of in data["summary"].items():
        for text, key in figures:
            if key in of:
                error = of[key]
                bound = (error.get("claimed_95_median"), error.get("within_claim"))
                rows.append((name, of["cameras"], of["refused"], text, error["median"], error["max"], *bound))
    header = ("arm, method", "cameras", "refused", "error", "median", "largest", "claimed bound, median", "held")
    corners, place = data["uncalibrated_keypoint_mean_px"], data["uncalibrated_object_mean_mm"]
    real = data["summary"]["real arm, hand"]["object_mean_mm"]["median"]
    body = table(header, rows)
    body += f"\nNot calibrated: corners {corners:.1f} px, the card's place {place:.0f} mm off in the mean.\n"
    return f"card's place {real:.2f} mm off, {place:.0f} mm without", body

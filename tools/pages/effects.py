"""docs/reference/effects.md: the catalogue of effects, from the records of sim2real.effects."""

from __future__ import annotations

import sim2real.effects

from pages.markdown import head, table

INTRODUCTION = """Parametric models of effects that the nominal simulator lacks. An entry of `patch.yaml` has an id, a component (a joint's
name, or `arm`) and the parameters below, in SI units, as changes against the nominal arm. The module is the place that reports name."""
RECORDED = """Ranges are physical limits. Visible is the smallest size that the excitation suite can show, base to wrist.
Carried by: the simulated arm of the bridge, the forward model of the diagnosis, training."""
VIEW = """Effects of a simulated camera and its keypoints. The component is `camera` or `keypoints`; changes are against the camera in use (as trained, or
the calibration file's). Visible is the smallest size that the task suite is meant to show. Carried by: the images of a backend; the keypoints of
`keypoint_oracle`; training. Latency is clipped so that an image never shows a time later than its stamp."""
SCENE = """Effects of contact, object and table in a simulated scene. The component is the module; changes are against the task's values (relative where there
is no unit). Frictions are the object's; obstacles rise with the table. Carried by: the simulated robot of the bridge, in both engines; training."""


def page() -> str:
    """The page: one table of all effects."""
    header = ("effect", "module", "where", "model", "parameters", "visible", "carried by")
    return (
        head("Effects", "the records of sim2real.effects", f"{INTRODUCTION} {RECORDED}")
        + table(header, (recorded(record) for record in sim2real.effects.ARM_EFFECTS.values()))
        + parts("Camera and keypoints", VIEW, sim2real.effects.CAMERA_EFFECTS)
        + parts("Contact, object and table", SCENE, sim2real.effects.SCENE_EFFECTS)
    )


def parts(title: str, introduction: str, records) -> str:
    """The effects of view or scene: a section."""
    header = ("effect", "component", "model", "parameters", "visible", "carried by")
    rows = (
        (
            f"`{record.id}`",
            str(record.target),
            record.entry["model"],
            ranges(record),
            f"{record.detection_limit.limit:g} {'' if record.detection_limit.unit == '1' else record.detection_limit.unit}".strip(),
            ", ".join(record.supported_in),
        )
        for record in records.values()
    )
    return f"\n## {title}\n\n{introduction}\n\n" + table(header, rows)


def ranges(record) -> str:
    """What a patch may give, each with its range."""
    numbers = (
        f"`{q.name}` {q.lower:g} to {q.upper:g} {'' if q.unit == '1' else q.unit}".strip() for q in record.quantities
    )
    return "; ".join(numbers)


def recorded(record) -> tuple[str, ...]:
    """The row of an sim2real.effects.effect.Effect."""
    visible = ""
    if record.detection_limit:
        limit = record.detection_limit.limit
        visible = f"{', '.join(f'{x:g}' for x in limit) if isinstance(limit, tuple) else f'{limit:g}'}"
        visible += "" if record.detection_limit.unit == "1" else f" {record.detection_limit.unit}"
    model = record.entry["model"]
    return (
        f"`{record.id}`",
        record.module,
        str(record.target),
        model,
        ranges(record),
        visible,
        ", ".join(record.supported_in),
    )

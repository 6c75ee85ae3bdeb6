"""docs/reference/effects.md: the catalogue of effects, from the records of sim2real.effects."""

from __future__ import annotations

import sim2real.effects

from pages.markdown import head, table

INTRODUCTION = """What an arm may have that its nominal simulator has not. An entry of `patch.yaml` is an id, a
component (a joint's name, or `arm`) and the parameters below, in SI units, as changes against the nominal arm. A module
is where reports say that an effect sits."""
VIEW = """What the view of a simulated robot may have: its component is `camera` or `keypoints`, changes are against the camera that is
believed in (as trained, or the calibration file's). Visible is the limit from which on the task suite is meant to show it. Carried by:
the images of a backend; the keypoints of `keypoint_oracle`, in the detector's place; training. Nothing shows what is still to come: an image
that would be of a later moment than its stamp is of its stamp."""
SCENE = """What contact, object and table of a simulated scene may have: its component is the module, changes are against the domain (a share,
where there is no unit). Frictions are of the object; obstacles rise with the table. Carried by: the simulated robot of the bridge, in both engines; training."""
RECORDED = """Ranges are what is physical. Visible is the magnitude from which on the excitation suite can show an
effect at all, base to wrist. Carried by: the simulated arm of the bridge, the doctor's forward model, training."""


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

"""task.html: the task diagnosis on one screen, a row for each module with its picture."""

from __future__ import annotations

from np_common.html_pages import page
from np_description.camera import CAMERA, Camera
from sim2real.report.plots import loop_plot
from sim2real.report.task_plots import pictures
from sim2real.task.diagnosis import TaskDiagnosis

COLOURS = {
    "identified": "#c0392b",
    "ambiguous": "#b9770e",
    "unexplained": "#7d3c98",
    "no_gap": "#1e8449",
}
QUIET = "#8a8f98"


def render(diagnosis: TaskDiagnosis, report: dict, camera: Camera = CAMERA) -> str:
    """The page as text. report: its `task_document.document`."""
    drawings = pictures(diagnosis, camera)
    rows = [
        {**row, "picture": drawings.get(row["module"], ""), "colour": COLOURS.get(row["verdict"], QUIET)}
        for row in report["rows"]
    ]
    loop_plots = [loop_plot(log.loop, log.duration) for log in diagnosis.recordings.logs]
    return page("sim2real", "task.html.j2", report=report, rows=rows, loop_plots=loop_plots)

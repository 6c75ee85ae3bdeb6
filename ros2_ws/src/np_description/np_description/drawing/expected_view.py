"""What the camera sees from where the policies were trained: outlines to aim a real camera by, before its calibration."""

from __future__ import annotations

import numpy as np

from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.keypoints import CORNERS

STEP = 0.1
"""Between two lines on the table, m."""
_EDGES = [(a, b) for a in range(8) for b in range(a) if np.abs(CORNERS[a] - CORNERS[b]).sum() == 2]


def find_expected_outlines(domain: Task) -> np.ndarray:
    """Ends (n, 2, 2) px of straight lines: every 0.1 m across the domain's workspace on the table, and edges of its fixed boxes."""
    x, y = (
        np.arange(np.ceil(a / STEP - 1e-9), b / STEP + 1e-9) * STEP for a, b in (domain.workspace_x, domain.workspace_y)
    )
    across = [[(at, y[0], 0.0), (at, y[-1], 0.0)] for at in x]
    along = [[(x[0], at, 0.0), (x[-1], at, 0.0)] for at in y]
    boxes = [np.asarray(box.centre) + CORNERS * box.half_size for box in domain.obstacles]
    edges = [[corners[a], corners[b]] for corners in boxes for a, b in _EDGES]
    return CAMERA.project(np.array([*across, *along, *edges], dtype=float))[0]

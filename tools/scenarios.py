"""The fixed scenarios of a domain as a picture: `python tools/scenarios.py card out.png`.

Each as the camera sees its start, with the goal outlined and its corners in their colours; without scatter.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from np_description.camera import CAMERA
from np_description.domains import Domain, find_domain
from np_description.keypoints import box_keypoints
from np_description.objects.scenarios import COUNT, fixed_task
from np_description.panda import NOMINAL
from np_description.scene import CORNER_COLOURS, load_model
from np_record.report.video import SCALE, draw_box
from np_sim_bridge.renderer import make_renderer


def picture(domain: Domain) -> np.ndarray:
    """Pixels (height, width, 3) uint8 RGB: the scenarios side by side."""
    renderer, panels = make_renderer("auto", load_model(domain)), []
    for number in range(1, COUNT + 1):
        start, goal = fixed_task(domain, number)
        configuration = np.concatenate([NOMINAL.ready, [0.0, 0.0], start.position, start.quaternion])
        frame = cv2.resize(renderer.render(configuration), None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_NEAREST)
        draw_box(frame, goal, domain.half_size)
        corners = CAMERA.project(box_keypoints(np.asarray(domain.half_size), goal.position, goal.quaternion))[0]
        for (u, v), colour in zip(corners, CORNER_COLOURS):
            at = tuple(int(round((value + 0.5) * SCALE - 0.5)) for value in (u, v))
            cv2.circle(frame, at, 4, [255 * share for share in colour], -1, cv2.LINE_AA)
        cv2.putText(frame, str(number), (12, 36), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 2, cv2.LINE_AA)
        panels.append(frame)
    renderer.close()
    return np.hstack(panels)


if __name__ == "__main__":
    name, path = sys.argv[1:]
    pixels = picture(find_domain(name))
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(path, pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])

"""Outlines to aim a camera by."""

import numpy as np
import pytest

from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD, WALL
from np_description.drawing.expected_view import STEP, find_expected_outlines


@pytest.mark.parametrize("domain", [CARD, BUMP, WALL])
def test_lines_lie_every_ten_centimetres_on_the_table_then_edges_of_fixed_boxes(domain):
    lines = find_expected_outlines(domain)
    table, edges = np.split(lines, [len(lines) - 12 * len(domain.obstacles)])
    ends = CAMERA.at_height(CAMERA.rays(table.reshape(-1, 2)), 0.0)
    np.testing.assert_allclose(ends / STEP, np.round(ends / STEP), atol=1e-6)
    low, high = zip(domain.workspace_x, domain.workspace_y)
    assert (ends >= np.array(low) - 1e-6).all() and (ends <= np.array(high) + 1e-6).all()
    assert len(table) == len(np.unique(ends[:, 0].round(6))) + len(np.unique(ends[:, 1].round(6)))
    for box, drawn in zip(domain.obstacles, edges.reshape(-1, 12, 2, 2)):
        corners = np.unique(drawn.reshape(-1, 2).round(6), axis=0)
        top = [*box.centre[:2], box.centre[2] + box.half_size[2]] + np.array([[1, 1, 0], [-1, -1, 0]]) * box.half_size
        assert len(corners) == 8
        for pixel in CAMERA.project(top)[0]:
            assert np.abs(corners - pixel).max(axis=1).min() < 1e-5

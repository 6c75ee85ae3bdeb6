"""The sheet of an object's coloured faces, and its command."""

import json

import numpy as np
import pytest

from np_description.domains import BUMP, CARD, DOMAINS
from np_description.keypoints import CORNERS
from np_description.scene import CORNER_COLOURS
from np_perception.commands.object_sheet import main
from np_perception.object_sheet import faces, pages

COLOURS = np.rint(255 * np.asarray(CORNER_COLOURS)).astype(np.uint8)


def test_a_face_is_as_who_stands_before_it_sees_it():
    whole = faces(CARD.half_size)
    assert {tuple(face.out) for face in whole} == {tuple(sign * axis) for sign in (1, -1) for axis in np.eye(3)}
    for face in whole:
        np.testing.assert_array_equal(np.cross(face.right, face.up), face.out)  # towards the eye: no mirror image
        for right in (-1, 1):
            for up in (-1, 1):
                corner = CORNERS[face.keypoint(right, up)]
                assert [corner @ face.out, corner @ face.right, corner @ face.up] == [1, right, up]
    (top,) = (face for face in whole if face.out[2] == 1)
    assert top.size == pytest.approx((0.07, 0.05))  # y to the left, x up


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda domain: domain.name)
def test_every_corner_is_printed_on_three_faces_to_scale(domain):
    dpi = 127  # five dots a millimetre
    printed = np.zeros(8)
    for sheet in pages(domain.half_size, domain.name, dpi):
        assert sheet.shape == (1485, 1050, 3)
        printed += [(sheet == colour).all(axis=-1).sum() for colour in COLOURS]
    x, y, z = domain.half_size
    np.testing.assert_allclose(printed, 25e6 * (x * y + x * z + y * z), rtol=0.03)


def test_the_command_writes_a_page_that_is_a4_and_refuses_what_does_not_fit(tmp_path, capsys):
    out = tmp_path / "new" / "bump.pdf"
    assert main(["--domain", "bump", "--out", str(out)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"sheet": str(out), "pages": 3, "size_m": [2 * half for half in BUMP.half_size]}
    written = out.read_bytes()
    assert written.startswith(b"%PDF") and written.count(b"/MediaBox [ 0 0 595.2 841.92 ]") == 3  # points, of 1/72 inch
    with pytest.raises(
        ValueError, match="expected faces of at most 0.176 x 0.246 m, which fit on A4, got 0.020 x 0.300 m"
    ):
        pages((0.15, 0.01, 0.01), "a plank")
    assert main(["--object", "nothing", "--out", str(out)]) == 1
    assert "object: expected one of default, wrapped" in capsys.readouterr().err

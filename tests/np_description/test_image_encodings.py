"""Pictures as the camera drivers of a laboratory publish them: read rightly, or refused by the name of their encoding."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import CompressedImage, Image

from np_description.message_arrays import ENCODINGS, BadMessage, decode_compressed_image, image_array

HEIGHT, WIDTH, SEAM = 8, 16, 8
UNREAD = ("mono16", "16UC1", "32FC1", "rgb16", "bayer_rggb16", "8UC3", "nv21", "RGB8", "")
"""16 bits have no known range, 8UC3 has no known order of colours."""


def image(encoding: str, rows: np.ndarray, width: int, padding: int = 0, **changes) -> Image:
    """A message of bytes (height, bytes of a row), each row followed by `padding` bytes of another value."""
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=170)
    message = Image(height=len(rows), width=width, encoding=encoding, step=padded.shape[1], data=padded.tobytes())
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def yuv(picture: np.ndarray) -> np.ndarray:
    """BT.601 with luma 16 .. 235 (height, width, 3) of RGB, by the standard's own numbers."""
    r, g, b = np.moveaxis(picture / 255, -1, 0)
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    return np.stack([16 + 219 * luma, 128 + 112 * (b - luma) / 0.886, 128 + 112 * (r - luma) / 0.701], axis=-1)


def encode(encoding: str, picture: np.ndarray) -> np.ndarray:
    """Rows of bytes of a picture (height, width, 3) RGB; for YUV the pixels of a pair have one colour."""
    height, width = picture.shape[:2]
    if encoding.startswith("bayer"):
        cell = ["rgb".index(colour) for colour in encoding.split("_")[1].removesuffix("8")]
        rows = np.empty((height, width), np.uint8)
        for place, channel in enumerate(cell):
            rows[place // 2 :: 2, place % 2 :: 2] = picture[place // 2 :: 2, place % 2 :: 2, channel]
        return rows
    if encoding in ("yuyv", "yuv422_yuy2", "uyvy", "yuv422"):
        y, u, v = np.moveaxis(yuv(picture).round().astype(np.uint8), -1, 0)
        chroma = np.where(np.arange(width) % 2 == 0, u, v)
        pair = (y, chroma) if encoding.startswith(("yuyv", "yuv422_")) else (chroma, y)
        return np.stack(pair, axis=-1).reshape(height, -1)
    channels = {"r": picture[..., 0], "g": picture[..., 1], "b": picture[..., 2], "a": np.full((height, width), 9)}
    if encoding == "mono8":
        return picture[..., 0]
    return np.stack([channels[c] for c in encoding.removesuffix("8")], axis=-1).astype(np.uint8).reshape(height, -1)


def test_the_page_lists_what_is_read():
    page = (Path(__file__).resolve().parents[2] / "docs/guide/troubleshooting.md").read_text()
    table = page.partition("### Images")[2].partition("Encodings of 16 bits")[0]
    assert set(re.findall("`(.*?)`", table)) == {*ENCODINGS, "camera/image_raw"}


colours = st.tuples(*[st.integers(0, 255)] * 3)


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(left=colours, right=colours, padding=st.integers(0, 9), is_bigendian=st.booleans())
def test_a_known_picture_comes_back(encoding, left, right, padding, is_bigendian):
    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    picture[:, :SEAM], picture[:, SEAM:] = left, right
    if encoding == "mono8":
        picture[..., 1:] = picture[..., :1]
    message = image(encoding, encode(encoding, picture), WIDTH, padding, is_bigendian=int(is_bigendian))
    got = image_array(message)
    assert got.shape == picture.shape and got.dtype == np.uint8 and not got.flags.writeable
    # A Bayer mosaic has a colour at every second pixel only; YUV of 8 bits has fewer steps than RGB.
    seen = np.abs(np.arange(WIDTH) - SEAM + 0.5) > (1 if encoding.startswith("bayer") else 0)
    off = 3 if "yuy" in encoding or "uyv" in encoding or encoding == "yuv422" else 0
    np.testing.assert_allclose(got[:, seen].astype(int), picture[:, seen].astype(int), rtol=0, atol=off)


@pytest.mark.parametrize("encoding", UNREAD)
def test_an_encoding_that_is_not_read_is_named_with_those_that_are(encoding):
    with pytest.raises(BadMessage) as refusal:
        image_array(image(encoding, np.zeros((HEIGHT, 6 * WIDTH), np.uint8), WIDTH))
    assert refusal.value.kind == "encoding" and "\n" not in str(refusal.value)
    assert str(refusal.value).endswith(f"got '{encoding}'") and all(name in str(refusal.value) for name in ENCODINGS)


@pytest.mark.parametrize("encoding, height, width", [("yuyv", 4, 5), ("bayer_rggb8", 5, 4), ("bayer_rggb8", 2, 8)])
def test_cells_that_are_cut_are_refused(encoding, height, width):
    rows = np.zeros((height, ENCODINGS[encoding][0] * width), np.uint8)
    with pytest.raises(BadMessage, match=f"whole {encoding} cells, got {height} x {width}"):
        image_array(image(encoding, rows, width))


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(height=st.integers(1, 6), width=st.integers(1, 6), value=st.integers(0, 255))
def test_a_plain_picture_of_any_size_is_read_or_refused(encoding, height, width, value):
    depth = ENCODINGS[encoding][0]
    message = image(encoding, np.full((height, depth * width), value, np.uint8), width)
    try:
        got = image_array(message)
    except BadMessage as error:
        assert error.kind == "shape" and encoding.startswith(("y", "uyvy", "bayer"))
    else:
        assert got.shape == (height, width, 3) and (got == got[0, 0]).all()


PICTURE = np.full((HEIGHT, WIDTH, 3), (200, 90, 30), np.uint8)


@pytest.mark.parametrize(
    "text, suffix",
    [("jpeg", "jpg"), ("jpg", "jpg"), ("png", "png"), ("rgb8; jpeg compressed bgr8", "jpg")]
    + [("bgr8; png compressed bgr8", "png"), ("mono8; jpeg compressed ", "jpg")],
)
def test_a_compressed_picture_comes_back(text, suffix):
    picture = PICTURE[..., :1].repeat(3, axis=-1) if text.startswith("mono") else PICTURE
    stored = picture[..., 0] if text.startswith("mono") else picture[..., ::-1]
    message = CompressedImage(format=text, data=cv2.imencode(f".{suffix}", stored)[1].tobytes())
    np.testing.assert_allclose(decode_compressed_image(message).astype(int), picture, rtol=0, atol=3)


@pytest.mark.parametrize(
    "text",
    ["", "h264", "16UC1; compressedDepth", "mono16; png compressed ", "bayer_rggb8; jpeg compressed ", "tiff"]
    + ["rgb8; jpeg compressed rgb8", "bgr16; png compressed bgr16"],
)
def test_a_format_that_is_not_read_is_named(text):
    with pytest.raises(BadMessage, match="expected jpeg or png") as refusal:
        decode_compressed_image(CompressedImage(format=text, data=cv2.imencode(".png", PICTURE)[1].tobytes()))
    assert refusal.value.kind == "encoding" and str(refusal.value).endswith(f"got '{text}'")


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"text"])
def test_bytes_that_are_no_picture_are_refused(data):
    with pytest.raises(BadMessage, match=f"got {len(data)} bytes that make none"):
        decode_compressed_image(CompressedImage(format="jpeg", data=data))

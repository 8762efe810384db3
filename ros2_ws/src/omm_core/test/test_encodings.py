"""Whatever a camera encodes, the same scene gives the same dots."""

import cv2
import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.errors import InputError
from omm_core.imaging.encodings import KNOWN_ENCODINGS, grey_image, liberties
from omm_core.targets import detect_targets
from omm_core.targets.coded.families import TargetFamily

RNG = np.random.default_rng(4)
LUMA = {"r": 0.299, "g": 0.587, "b": 0.114}


def decode(data, encoding, height, width, step=None, big_endian=False):
    values = np.ascontiguousarray(data)
    return grey_image(
        values.tobytes(),
        encoding,
        height_px=height,
        width_px=width,
        step_bytes=values.nbytes // height if step is None else step,
        big_endian=big_endian,
    )


@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "bgra8", "rgba8", "8UC3", "bgr16", "rgba16"])
def test_colours_become_the_luma_of_bt_601(encoding):
    order = {"8UC3": "bgr"}.get(encoding, encoding.rstrip("0123456789"))
    depth = np.uint16 if encoding.endswith("16") else np.uint8
    colours = RNG.integers(0, np.iinfo(depth).max, (9, 7, len(order))).astype(depth)
    expected = sum(
        LUMA.get(name, 0.0) * colours[:, :, k].astype(float) for k, name in enumerate(order)
    )
    grey = decode(colours, encoding, 9, 7)
    assert grey.dtype == depth
    assert np.abs(grey - expected).max() <= (1.0 if depth is np.uint8 else 3.0)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_a_mosaic_of_one_colour_is_that_colours_luma(pattern, bits):
    """A wrong order of the pattern would exchange red with blue, or with green."""
    full = 200 << (bits - 8)
    for colour, share in LUMA.items():
        mosaic = np.zeros((12, 16), np.uint8 if bits == 8 else np.uint16)
        for k, name in enumerate(pattern):
            if name == colour:
                mosaic[k // 2 :: 2, k % 2 :: 2] = full
        grey = decode(mosaic, f"bayer_{pattern}{bits}", 12, 16)[3:-3, 3:-3]
        assert np.abs(grey / full - share).max() < 0.01, colour


@pytest.mark.parametrize(("encoding", "place"), [("yuv422_yuy2", 0), ("uyvy", 1), ("yuv422", 1)])
def test_of_yuv_the_brightness_is_taken(encoding, place):
    values = RNG.integers(0, 255, (6, 8, 2)).astype(np.uint8)
    assert np.array_equal(decode(values, encoding, 6, 8), values[:, :, place])


def test_a_grey_scene_gives_the_same_centres_in_every_encoding():
    family = TargetFamily.by_name("metashape12")
    rng = np.random.default_rng(8)
    scene = as_seen(rng, target_image(rng)[0])
    scene = scene[: scene.shape[0] // 2 * 2, : scene.shape[1] // 2 * 2]
    (expected,) = detect_targets(scene, family).targets
    height, width = scene.shape
    encoded = {
        "bgr8": cv2.cvtColor(scene, cv2.COLOR_GRAY2BGR),
        "rgba8": cv2.cvtColor(scene, cv2.COLOR_GRAY2RGBA),
        "yuv422_yuy2": np.dstack([scene, np.full_like(scene, 128)]),
        "mono16": scene.astype(np.uint16) << 8,
        "bayer_rggb8": scene,
    }
    for encoding, data in encoded.items():
        (found,) = detect_targets(decode(data, encoding, height, width), family).targets
        limit_px = 0.02 if encoding.startswith("bayer") else 1e-3
        assert np.abs(found.center_px - expected.center_px).max() < limit_px, encoding


def test_padding_and_byte_order_change_nothing():
    pixels = RNG.integers(0, 65535, (4, 3)).astype(np.uint16)
    padded = np.full((4, 11), 7, dtype=np.uint8)  # an odd step
    padded[:, :6] = pixels.astype(">u2").view(np.uint8).reshape(4, 6)
    assert np.array_equal(decode(padded, "mono16", 4, 3, step=11, big_endian=True), pixels)


@pytest.mark.parametrize("encoding", ["Mono8", "MONO16", "Bayer_RGGB8", "BGR8", "8uc1"])
def test_capitals_of_an_encoding_say_the_same_and_are_told(encoding):
    proper = next(name for name in KNOWN_ENCODINGS if name.lower() == encoding.lower())
    values = RNG.integers(0, 255, (6, 8 * 6)).astype(np.uint8)
    as_ros, as_told = (decode(values, name, 6, 8) for name in (proper, encoding))
    assert np.array_equal(as_ros, as_told)
    assert liberties(proper, 8) == ""
    assert repr(encoding) in liberties(encoding, 8)


@pytest.mark.parametrize(("encoding", "row"), [("mono8", 5), ("mono16", 10), ("bgra8", 20)])
def test_a_step_of_0_is_rows_without_padding_where_the_data_agree(encoding, row):
    values = RNG.integers(0, 255, (6, row)).astype(np.uint8)
    expected = decode(values, encoding, 6, 5)
    assert np.array_equal(decode(values, encoding, 6, 5, step=0), expected)
    assert "step of 0" in liberties(encoding, 0)
    for other in (values[:5], np.vstack([values, values[:1]])):  # which padding it has is not known
        with pytest.raises(InputError, match="in rows of 0: the image is damaged"):
            decode(other, encoding, 6, 5, step=0)


@pytest.mark.parametrize("encoding", ["", "jpeg", "32FC1", "nv21"])
def test_other_encodings_are_refused_with_what_came(encoding):
    with pytest.raises(InputError, match=f"got '{encoding or 'no encoding'}'"):
        decode(np.zeros((4, 4), np.uint8), encoding, 4, 4)


@pytest.mark.parametrize("encoding", KNOWN_ENCODINGS)
def test_an_image_that_is_short_is_refused(encoding):
    with pytest.raises(InputError, match="the image is damaged"):
        decode(np.zeros((4, 3), np.uint8), encoding, 4, 4)

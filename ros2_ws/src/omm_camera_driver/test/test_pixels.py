"""Packed pixel formats, against packing them bit by bit as the standards draw it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omm_camera_driver import pixels
from omm_core.errors import DeviceError


def packed(values: list[int], bits: int, gige: bool) -> bytes:
    """Bytes of pixel values: GigE Vision's packing of pairs, or PFNC's stream of bits."""
    if gige:
        low = bits - 8
        out = bytearray()
        for a, b in zip(values[::2], values[1::2]):
            mask = (1 << low) - 1
            out += bytes([a >> low, (a & mask) | (b & mask) << 4, b >> low])
        return bytes(out)
    stream = sum(value << bits * i for i, value in enumerate(values))
    return stream.to_bytes(bits * len(values) // 8, "little")


@pytest.mark.parametrize(
    ("pixel_format", "bits", "gige"),
    [
        (pixels.MONO10_PACKED, 10, True), (pixels.MONO12_PACKED, 12, True),
        (pixels.MONO10P, 10, False), (pixels.MONO12P, 12, False),
    ],
)  # fmt: skip
@given(data=st.data())
def test_unpacking_undoes_packing(
    pixel_format: int, bits: int, gige: bool, data: st.DataObject
) -> None:
    values = data.draw(st.lists(st.integers(0, 2**bits - 1), min_size=8, max_size=8))
    raw = np.frombuffer(packed(values, bits, gige), np.uint8)
    image = pixels.mono_from_genicam(raw, pixel_format, 4, 2)
    np.testing.assert_array_equal(image.reshape(-1), np.array(values) << (16 - bits))


@pytest.mark.parametrize(
    ("pixel_format", "bits"),
    [(pixels.MONO10, 10), (pixels.MONO12, 12), (pixels.MONO14, 14), (pixels.MONO16, 16)],
)
def test_wide_pixels_fill_16_bits(pixel_format: int, bits: int) -> None:
    values = np.array([[0, 1], [2**bits - 2, 2**bits - 1]], "<u2")
    image = pixels.mono_from_genicam(values.reshape(-1).view(np.uint8), pixel_format, 2, 2)
    np.testing.assert_array_equal(image, values << (16 - bits))


def test_mono8_is_not_copied() -> None:
    data = np.zeros(12, np.uint8)
    assert np.shares_memory(pixels.mono_from_genicam(data, pixels.MONO8, 4, 3), data)


def test_an_unknown_format_is_refused() -> None:
    with pytest.raises(DeviceError, match="pixel_format"):
        pixels.mono_from_genicam(np.zeros(100, np.uint8), 0x02180020, 4, 3)


def test_too_few_bytes_are_refused() -> None:
    with pytest.raises(DeviceError, match="got 5"):
        pixels.mono_from_genicam(np.zeros(5, np.uint8), pixels.MONO8, 4, 3)


@pytest.mark.parametrize(
    ("pixel_format", "first"),
    [
        (0x01080009, "r"),  # BayerRG8
        (0x0108000B, "b"),  # BayerBG8
        (0x01100011, "r"),  # BayerRG12
        (0x0110002F, "r"),  # BayerRG16
    ],
)
def test_a_mosaic_becomes_the_luma_of_what_lights_its_first_pixel(pixel_format, first):
    """PFNC names the first two pixels of the first row."""
    bits = {0x01100011: 12, 0x0110002F: 16}.get(pixel_format, 8)
    mosaic = np.zeros((12, 16), np.uint8 if bits == 8 else np.uint16)
    mosaic[::2, ::2] = (1 << bits) - 1
    raw = mosaic.reshape(-1).view(np.uint8)
    grey = pixels.mono_from_genicam(raw, pixel_format, 16, 12)
    share = grey[3:-3, 3:-3].mean() / np.iinfo(grey.dtype).max
    assert share == pytest.approx({"r": 0.299, "b": 0.114}[first], abs=0.01)


@pytest.mark.parametrize(("pixel_format", "order"), [(0x02180014, "rgb"), (0x02180015, "bgr")])
def test_colours_become_their_luma(pixel_format, order):
    colours = np.zeros((4, 6, 3), np.uint8)
    colours[:, :, order.index("r")] = 200
    grey = pixels.mono_from_genicam(colours.reshape(-1), pixel_format, 6, 4)
    assert np.all(grey == 60)


def test_bytes_after_each_row_are_left_out() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(4, 6)
    padded = np.pad(image, ((0, 0), (0, 2)), constant_values=99).reshape(-1)
    for raw in (padded, padded[:-2]):  # the last row's padding may be missing
        np.testing.assert_array_equal(
            pixels.mono_from_genicam(raw, pixels.MONO8, 6, 4, row_padding=2), image
        )


def test_packed_pixels_that_end_within_a_byte_are_refused() -> None:
    with pytest.raises(DeviceError, match="roi_width_px"):
        pixels.mono_from_genicam(np.zeros(100, np.uint8), pixels.MONO10P, 5, 3)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_an_image_on_which_nothing_can_be_seen_is_told(kind: type[np.generic]) -> None:
    full = np.iinfo(kind).max
    black, white = np.zeros((40, 60), kind), np.full((40, 60), full, kind)
    assert "black" in pixels.without_contrast(black)
    assert "white" in pixels.without_contrast(white)
    for image in (black, white):
        image[11:16, 21:26] = full // 2  # a dot of five pixels
        assert pixels.without_contrast(image) == ""

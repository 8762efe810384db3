"""The cameras that several tests use: Table 1 of the paper, and its like as plumb_bob."""

from omm_core.imaging.lens import BrownPhotogrammetric, PlumbBob

PAPER_LENS = BrownPhotogrammetric(
    width_px=2592, height_px=1944, pixel_size_mm=0.0022, focal_length_mm=6.189,
    cl0_px=-8.732, rw0_px=27.52, k1_px2=2.997e-08, k2_px4=-1.937e-15,
    p1_px=-6.188e-08, p2_px=3.408e-07,
)  # fmt: skip
PLUMB_BOB_LENS = PlumbBob(
    width_px=2592, height_px=1944, fx_px=2812.9, fy_px=2809.1, cx_px=1286.8, cy_px=999.0,
    k1=-0.233, k2=0.241, p1=-0.00077, p2=0.00114, k3=-0.145,
)  # fmt: skip
LENSES = [PAPER_LENS, PLUMB_BOB_LENS]
LENS_NAMES = ["brown_photogrammetric", "plumb_bob"]

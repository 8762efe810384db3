"""The simulated camera: what it would see from where the spindle truly is.

Each pixel looks along its ray (`rays`) at the plate and at the targets' planes; the light falls
off (`light`), the lens blurs, the image smears as far as the spindle moves during the exposure,
and the sensor adds its noise (`sensor`).

The plate itself is not blurred (its texture is smooth as it is); targets and reflections are, and
what they cover: `out = plate (1 − blur(cover)) + brightness · blur(cover)`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_simulation.cell import Cell
from omm_simulation.light import light_between, light_grid
from omm_simulation.metal import GRID_STEP_PX, plate_grid, render_plate
from omm_simulation.rays import Floats, lens_numbers, plane_homography, see_plane
from omm_simulation.scene import Reflection, SceneTarget, scene_of
from omm_simulation.sensor import expose, quantise
from omm_simulation.target_image import PlaneOfPixel, disc_coverage, target_coverage

Image32 = NDArray[np.float32]

SHARP_PX = 0.02
"""An image that moves by less during the exposure is taken at its middle alone."""
SMEAR_STEP_PX = 2.0
MOST_SMEAR_STEPS = 24
FINE_CELLS, SMALL_TARGET_PX = 4, 120
"""Pixels are cut into so many cells squared, where a target is small or a dot is drawn."""
SAME_PLACE_MM = 1e-6
"""A spindle that moved by less sees the same image (1e-5 px): only the noise is made anew."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Window:
    """A part of the image, which may reach beyond its border."""

    first_col: int
    first_row: int
    width: int
    height: int

    def grid_shape(self) -> tuple[int, int]:
        """Return the rows and columns of a grid of every GRID_STEP_PX-th pixel that covers it."""
        return -(-self.height // GRID_STEP_PX) + 1, -(-self.width // GRID_STEP_PX) + 1

    def as_tuple(self) -> tuple[int, int, int, int]:
        return self.first_col, self.first_row, self.width, self.height


class SimulatedCamera:
    """A camera in a cell's spindle.

    Parameters
    ----------
    cell : Cell
    """

    def __init__(self, cell: Cell) -> None:
        self._imaging = cell.scenario.imaging
        self._distance_mm = cell.scenario.program.distance_mm
        self._calibration = cell.true_calibration
        self._lens = lens_numbers(self._calibration.lens)
        self._shape = (self._calibration.height_px, self._calibration.width_px)
        directions = self._calibration.lens.rays(self._calibration.lens.pixel_grid())[:, :2]
        self._field_of_view = directions.min(axis=0), directions.max(axis=0)
        self._spindle_T_camera = _spindle_T_camera(
            cell.gamma_s_rad, self._calibration.taper_T_camera
        )
        self._scene = scene_of(cell)
        self._seed = cell.clamping_seed
        self._last: tuple[tuple[RigidTransform, ...], Image32] | None = None

    def exposure_poses(
        self, machine_T_spindle_at: Callable[[int], RigidTransform], middle_ns: int
    ) -> tuple[RigidTransform, ...]:
        """Return where the spindle is during an exposure; a single pose where it stands still.

        Parameters
        ----------
        machine_T_spindle_at : callable
            The true pose at a time in ns.
        middle_ns : int
            The middle of the exposure, the image's stamp.
        """
        half_ns = self._imaging.exposure_s * 0.5e9
        at = [machine_T_spindle_at(round(middle_ns + s * half_ns)) for s in (-1.0, 0.0, 1.0)]
        smear_px = max(self._shift_px(at[0], at[1]), self._shift_px(at[1], at[2])) * 2
        if smear_px < SHARP_PX:
            return (at[1],)
        steps = min(MOST_SMEAR_STEPS, max(3, int(np.ceil(smear_px / SMEAR_STEP_PX)) + 1))
        return tuple(
            machine_T_spindle_at(round(middle_ns + (2 * (k + 0.5) / steps - 1.0) * half_ns))
            for k in range(steps)
        )

    def image(
        self,
        machine_T_spindle: RigidTransform | Sequence[RigidTransform],
        *,
        frame: int,
        bits: int = 8,
        noise: bool = True,
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Take an image.

        Parameters
        ----------
        machine_T_spindle : RigidTransform or sequence of them
            Where the spindle truly is, or is in turn during the exposure (`exposure_poses`).
        frame : int
            Number of the image; the same number makes the same noise.
        bits : int
            8 or 16.
        noise : bool
            False for an image without noise (it is still quantised).

        Returns
        -------
        ndarray of uint8 or uint16, shape (H, W)
        """
        ideal = self.ideal(machine_T_spindle)
        if not noise:
            return quantise(ideal, bits=bits)
        return expose(ideal, self._imaging, seed=((self._seed << 32) + frame) % 2**64, bits=bits)

    def ideal(self, machine_T_spindle: RigidTransform | Sequence[RigidTransform]) -> Image32:
        """Return what the pixels would say without noise and quantisation (read-only; 8-bit scale).

        The last image is kept: while the spindle stands still there is nothing to render.
        """
        poses = (
            (machine_T_spindle,)
            if isinstance(machine_T_spindle, RigidTransform)
            else tuple(machine_T_spindle)
        )
        if self._last is not None and _same(self._last[0], poses):
            return self._last[1]
        image = self._render(poses[0])
        for pose in poses[1:]:
            image += self._render(pose)
        if len(poses) > 1:
            image /= np.float32(len(poses))
        image.setflags(write=False)
        self._last = (poses, image)
        return image

    def machine_T_camera(self, machine_T_spindle: RigidTransform) -> RigidTransform:
        """Return the camera's pose (paper eq. 21).

        R_C = R_CNC R_s R_calib, d_C = R_CNC R_s d_calib + d_CNC.
        """
        return machine_T_spindle @ self._spindle_T_camera

    def _shift_px(self, a: RigidTransform, b: RigidTransform) -> float:
        """Return roughly how far the image moves between two poses, px."""
        focal_px = self._lens[1]
        moved_mm = float(np.linalg.norm(a.translation_mm - b.translation_mm))
        turned_rad = float(np.linalg.norm(a.rotation - b.rotation)) / 2**0.5
        return focal_px * (moved_mm / self._distance_mm + turned_rad)

    def _render(self, machine_T_spindle: RigidTransform) -> Image32:
        camera_T_machine = self.machine_T_camera(machine_T_spindle).inverse()
        camera_T_plate = camera_T_machine @ self._scene.machine_T_plate
        image = self._plate(camera_T_plate)
        for reflection in self._scene.reflections:
            self._add_reflection(image, camera_T_plate, reflection)
        for target in self._scene.targets:
            camera_T_target = camera_T_machine @ self._scene.machine_T_part @ target.part_T_target
            self._add_target(image, camera_T_target, target)
        return image

    def _light(self, camera_T_plane: RigidTransform, window: _Window) -> Image32:
        """Return the light on a plane, on a grid that begins with the window and covers it."""
        light = light_grid(
            self._lens, np.ascontiguousarray(camera_T_plane.rotation[:, 2]),
            camera_T_plane.translation_mm, self._distance_mm,
            self._imaging.ring_light_radius_mm, self._imaging.vignetting,
            window.first_col, window.first_row, *window.grid_shape(),
        )  # fmt: skip
        return np.asarray(light, dtype=np.float32)

    def _plate(self, camera_T_plate: RigidTransform) -> Image32:
        imaging = self._imaging
        image = np.empty(self._shape, np.float32)
        whole = _Window(first_col=0, first_row=0, width=self._shape[1], height=self._shape[0])
        light = self._light(camera_T_plate, whole)
        if not light.any():  # nothing to be seen of the plate's front
            image[:] = imaging.black_dn
            return image
        homography = plane_homography(camera_T_plate.rotation, camera_T_plate.translation_mm)
        render_plate(
            plate_grid(self._lens, homography, *whole.grid_shape()),
            light,
            self._scene.metal.coarse,
            self._scene.metal.fine,
            np.float32(imaging.black_dn),
            np.float32(imaging.background_dn - imaging.black_dn),
            image,
        )
        return image

    def _add_target(
        self, image: Image32, camera_T_target: RigidTransform, target: SceneTarget
    ) -> None:
        window = self._window(camera_T_target, target.label_radius_mm)
        if window is None:
            return
        imaging, blur_px = self._imaging, self._imaging.blur_sigma_px
        plane_of_pixel = self._plane_of_pixel(camera_T_target)
        cover = disc_coverage(
            centre_mm=(0.0, 0.0), radius_mm=target.label_radius_mm, plane_of_pixel=plane_of_pixel,
            window=window.as_tuple(), blur_px=blur_px, cells=1,
        )  # fmt: skip
        film = self._film(target, plane_of_pixel, camera_T_target, window)
        contrast_dn = imaging.target_dn - imaging.backing_dn
        bright_dn = (imaging.backing_dn - imaging.black_dn) * cover + contrast_dn * film
        self._paste(image, window, self._light(camera_T_target, window), cover, bright_dn)

    def _film(
        self, target: SceneTarget, plane_of_pixel: PlaneOfPixel, camera_T_target: RigidTransform,
        window: _Window,
    ) -> Floats:  # fmt: skip
        """Return the coverage by dot and ring.

        The dot is exact, the ring of a large target less finely cut.
        """
        imaging, family = self._imaging, self._scene.family

        def coverage(inside: _Window, cells: int) -> Floats:
            return target_coverage(
                code=target.code, family=family, dot_radius_mm=target.dot_radius_mm,
                plane_of_pixel=plane_of_pixel, window=inside.as_tuple(),
                blur_px=imaging.blur_sigma_px, cells=cells,
            )  # fmt: skip

        dot = self._window(camera_T_target, target.dot_radius_mm)
        if dot is None or max(window.width, window.height) < SMALL_TARGET_PX:
            return coverage(window, FINE_CELLS)
        film = coverage(window, 1)
        # The dot's window lies in its label's, and no corner of it reaches the ring.
        row, col = dot.first_row - window.first_row, dot.first_col - window.first_col
        film[row : row + dot.height, col : col + dot.width] = coverage(dot, FINE_CELLS)
        return film

    def _add_reflection(
        self, image: Image32, camera_T_plate: RigidTransform, spot: Reflection
    ) -> None:
        centre_mm = np.append(spot.centre_mm, 0.0)
        cos, sin = np.cos(spot.angle_rad), np.sin(spot.angle_rad)
        plate_T_spot = RigidTransform(
            rotation=np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]),
            translation_mm=centre_mm,
        )
        camera_T_spot = camera_T_plate @ plate_T_spot
        window = self._window(camera_T_spot, spot.semi_axes_mm[0])
        if window is None:
            return
        plane_of_pixel = self._plane_of_pixel(camera_T_spot)
        stretch = spot.semi_axes_mm[0] / spot.semi_axes_mm[1]

        def as_a_circle(cols: Floats, rows: Floats) -> tuple[Floats, Floats]:
            x, y = plane_of_pixel(cols, rows)
            return x, y * stretch

        cover = disc_coverage(
            centre_mm=(0.0, 0.0), radius_mm=spot.semi_axes_mm[0], plane_of_pixel=as_a_circle,
            window=window.as_tuple(), blur_px=self._imaging.blur_sigma_px, cells=2,
        )  # fmt: skip
        bright_dn = (spot.grey_dn - self._imaging.black_dn) * cover
        self._paste(image, window, self._light(camera_T_spot, window), cover, bright_dn)

    def _plane_of_pixel(self, camera_T_plane: RigidTransform) -> PlaneOfPixel:
        homography = plane_homography(camera_T_plane.rotation, camera_T_plane.translation_mm)

        def plane_of_pixel(cols: Floats, rows: Floats) -> tuple[Floats, Floats]:
            pixels = np.stack([cols.ravel(), rows.ravel()], axis=-1)
            x, y = see_plane(self._lens, homography, pixels).T
            return x.reshape(cols.shape), y.reshape(cols.shape)

        return plane_of_pixel

    def _window(self, camera_T_disc: RigidTransform, radius_mm: float) -> _Window | None:
        """Return where a disc appears, with room for the blur; None where it is not seen."""
        centre, normal = camera_T_disc.translation_mm, camera_T_disc.rotation[:, 2]
        if centre @ normal >= 0.0 or centre[2] <= radius_mm:  # seen from behind, or not before us
            return None
        reach = radius_mm * np.hypot(1.0, centre[:2] / centre[2]) / (centre[2] - radius_mm)
        leftmost, rightmost = self._field_of_view
        if np.any(centre[:2] / centre[2] + reach < leftmost) or np.any(
            centre[:2] / centre[2] - reach > rightmost
        ):
            return None
        angles = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
        rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(32)], axis=-1) * radius_mm * 1.01
        pixels = self._calibration.lens.project(camera_T_disc @ rim)
        if not np.all(np.isfinite(pixels)):
            return None
        room_px = int(np.ceil(5 * self._imaging.blur_sigma_px)) + 2
        first = np.floor(pixels.min(axis=0)).astype(int) - room_px
        last = np.ceil(pixels.max(axis=0)).astype(int) + room_px
        height, width = self._shape
        if last[0] < 0 or last[1] < 0 or first[0] >= width or first[1] >= height:
            return None
        size = last - first + 1
        return _Window(
            first_col=int(first[0]), first_row=int(first[1]), width=int(size[0]),
            height=int(size[1]),
        )  # fmt: skip

    def _paste(
        self, image: Image32, window: _Window, light: Image32, cover: Floats, bright_dn: Floats
    ) -> None:
        """Lay something over the image: how it covers, how bright above black in full light."""
        lit = np.empty(cover.shape, np.float32)
        light_between(light, lit)
        laid = lit * bright_dn + self._imaging.black_dn * cover
        height, width = self._shape
        r0, c0 = max(0, window.first_row), max(0, window.first_col)
        r1 = min(height, window.first_row + window.height)
        c1 = min(width, window.first_col + window.width)
        inside = np.s_[
            r0 - window.first_row : r1 - window.first_row,
            c0 - window.first_col : c1 - window.first_col,
        ]
        image[r0:r1, c0:c1] = image[r0:r1, c0:c1] * (1.0 - cover[inside]) + laid[inside]


def _spindle_T_camera(gamma_s_rad: float, taper_T_camera: RigidTransform) -> RigidTransform:
    """Return the holder turned by γ_s in the spindle (paper eq. 22), written out here once more."""
    cos, sin = np.cos(gamma_s_rad), np.sin(gamma_s_rad)
    holder = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return RigidTransform(
        rotation=holder @ taper_T_camera.rotation,
        translation_mm=holder @ taper_T_camera.translation_mm,
    )


def _same(a: tuple[RigidTransform, ...], b: tuple[RigidTransform, ...]) -> bool:
    return len(a) == len(b) and all(
        np.abs(p.translation_mm - q.translation_mm).max() < SAME_PLACE_MM
        and np.abs(p.rotation - q.rotation).max() < SAME_PLACE_MM * 1e-3
        for p, q in zip(a, b)
    )

"""The renderer's geometry against a recording that an independent program made (data/bench)."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from omm_core.files.part import load_part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import load_calibration
from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import draw
from omm_simulation.rays import lens_numbers, plane_homography, see_plane
from omm_simulation.scenario import load_scenario

BENCH = Path(__file__).resolve().parents[4].parent / "shared" / "data" / "bench"

pytestmark = pytest.mark.skipif(
    not (BENCH / "run.mcap").is_file(), reason=f"the recording is not there: {BENCH}"
)


def recorded():
    """The recording's poses by their stamps."""
    mcap = pytest.importorskip("mcap.reader")
    typesys = pytest.importorskip("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    poses = {}
    with open(BENCH / "run.mcap", "rb") as stream:
        reader = mcap.make_reader(stream)
        for schema, _, message in reader.iter_messages(topics=["/cnc/spindle_pose"]):
            ros = types.deserialize_cdr(message.data, schema.name)
            stamp_ns = ros.header.stamp.sec * 10**9 + ros.header.stamp.nanosec
            p, q = ros.pose.position, ros.pose.orientation
            poses[stamp_ns] = RigidTransform.from_quaternion_xyzw(
                (q.x, q.y, q.z, q.w), 1e3 * np.array([p.x, p.y, p.z])
            )
    return poses


@pytest.fixture(scope="module")
def bench():
    truth = json.loads((BENCH / "truth.json").read_text())
    theta = truth["theta"]
    scenario = dataclasses.replace(
        load_scenario("ideal"), calibration=load_calibration(BENCH / "camera.yaml")
    )
    cell = dataclasses.replace(
        draw(scenario, 7),
        machine_T_part=RigidTransform.from_euler_xyz_rad(
            theta["alpha_rad"], theta["beta_rad"], theta["gamma_rad"],
            (theta["x_mm"], theta["y_mm"], theta["z_mm"]),
        ),
        gamma_s_rad=theta["gamma_s_rad"],
        true_part=load_part(BENCH / "part.yaml"),
        true_calibration=scenario.calibration,
    )  # fmt: skip
    return cell, truth["images"], recorded()


def pose_near(poses, stamp_ns):
    return poses[min(poses, key=lambda other_ns: abs(other_ns - stamp_ns))]


def test_rays_meet_the_targets_where_the_other_program_saw_them(bench):
    cell, images, poses = bench
    camera = SimulatedCamera(cell)
    lens = lens_numbers(cell.scenario.calibration.lens)
    for image in images:
        machine_T_camera = camera.machine_T_camera(pose_near(poses, image["stamp_ns"]))
        for seen in image["targets"]:
            target = cell.true_part.target(seen["id"])
            part_T_target = RigidTransform(rotation=np.eye(3), translation_mm=target.xyz_mm)
            camera_T_target = machine_T_camera.inverse() @ cell.machine_T_part @ part_T_target
            homography = plane_homography(camera_T_target.rotation, camera_T_target.translation_mm)
            pixel = np.array([[seen["col_px"], seen["row_px"]]])
            met_mm = see_plane(lens, homography, pixel)
            np.testing.assert_allclose(met_mm, 0.0, atol=1e-4)  # 1e-3 px

"""What is attacked: sound files of every kind that omm reads, and what reads them."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from hostile_inputs import Outcome, observed, recording_with_sound_sums, run_command
from recorded_samples import IMAGE, POSE, START_NS, Messages

from omm_core.errors import OmmError
from omm_recording.reading import Recording
from omm_recording.rosbag2_format import TopicQos
from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord

PART = b"""part: {name: plate}
target_family: metashape12
targets:
- {id: 42, xyz_mm: [0.0, 0.0, 3.75], dot_diameter_mm: 8.0, normal: [0.0, 0.0, 1.0]}
- {id: 40, xyz_mm: [1500.0, 0.0, 11.9], dot_diameter_mm: 8.0, sigma_xyz_mm: 0.02}
- {id: 8, xyz_mm: [1500.0, 1000.0, 8.27], dot_diameter_mm: 8.0, sigma_xyz_mm: [0.1, 0.1, 0.2]}
box_mm: [[0, 0, 0], [1500, 1000, 500]]
nominal: {translation_mm: [100, 200, null], euler_xyz_rad: [0, 0, 0]}
tolerances: {alpha_rad: 5.0e-5, beta_rad: 5.0e-5, z_mm: 1.0}
jacks: [{name: J1, xyz_mm: [-400, -100, 0], travel_mm: [-20, 20]}]
"""
CAMERA = b"""camera: {name: small, width_px: 64, height_px: 48, pixel_size_mm: 0.0022}
model: brown_photogrammetric
intrinsics: {focal_length_mm: 6.189, principal_point_offset_px: [-8.732, 27.52],
  k1_px2: 2.997e-08, k2_px4: -1.937e-15, p1_px: -6.188e-08, p2_px: 3.408e-07}
taper_to_camera: {translation_mm: [-2.139, 0.301, -320.2], euler_xyz_rad: [3.1386, -0.009, 0.03]}
covariance: {parameters: [focal_length_mm, x_mm], matrix: [[1.0e-6, 0.0], [0.0, 1.0e-4]]}
imaging: {exposure_s: 0.01, focus_mm: [200, 500], max_tilt_rad: 0.7}
body: {radius_mm: 60, z_mm: [-400, 0]}
"""
MACHINE = b"""machine: {name: mill 1, urdf: mill.urdf, up: [0, 0, 1]}
uncertainty: {stop_sigma_mm: 0.003, geometry_sigma_mm: null, geometry_length_mm: 500.0}
axes:
  X: {velocity_mm_per_s: 1000, acceleration_mm_per_s2: 3000, jerk_mm_per_s3: 30000}
  Y2: {follows: Y, tolerance_mm: 0.02}
  W: {ignored: true}
timing: {settling_s: 0.3, image_s: 0.5}
"""
URDF = b"""<robot name="r"><link name="base"/><link name="x"/><link name="spindle"/>
<joint name="X" type="prismatic"><parent link="base"/><child link="x"/><origin xyz="0 0 1"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>
<joint name="C" type="revolute"><parent link="x"/><child link="spindle"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3"/></joint></robot>
"""
MAPPING = b"""axes:
  X: {position: Axes/X/ActPos, status: Axes/X/Status, in_position: 1, unit: mm}
  C: {position: "ns=2;s=C.ActPos", unit: deg}
channel: {mode: Channel/Mode, program_status: Channel/State}
modes: {0: MANUAL, 2: AUTOMATIC}
acknowledge: "ns=2;s=Done"
"""
SET = b"""kind: cmm
camera: {name: c, width_px: 64, height_px: 48, pixel_size_mm: 0.0022}
model: brown_photogrammetric
points: points.csv
target: {dot_diameter_mm: 5.0, normal: [0.0, 0.0, 1.0]}
sigma_xyz_mm: 0.001
sigma_px: 0.015
"""
CSV = b"image,x_mm,y_mm,z_mm,col_px,row_px\n1.png,0,1,2,10,20\n2.png,3,4.5,5e1,11.25,20.5\n"
SURVEY = b"""camera: {width_px: 64, height_px: 48, pixel_size_mm: 0.007, focal_length_mm: 24}
photos: "*.jpg"
target_family: aicon12
coded_dot_diameter_mm: 10.0
scale_bars: [{ends: [113, 98], length_mm: 1400.0473, sigma_mm: 0.004}]
check_bars: [{ends: [64, 119], length_mm: 899.2734, sigma_mm: 0.004}]
"""
FIT = b"""points: points.json
cad: part.stl
target_thickness_mm: 0.15
criterion: even
minimum_overstock_mm: 0.5
groups: [{name: top, faces: [1, 2], minimum_overstock_mm: 1}]
pairs: [{point: "69", xyz_mm: [68.6, 745.1, 415.3]}]
"""
POINTS = b"""{"target_family": "aicon12", "coded_dot_diameter_mm": 8.0,
"plain_dot_diameter_mm": 6.0, "points": [
{"name": "69", "coded": true, "id": 69, "xyz_mm": [1.0, 2.0, 3.0], "normal": [0, 0, 1],
"covariance_mm2": [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]]},
{"name": "p1", "coded": false, "xyz_mm": [10.0, 2.0, 3.0], "sigma_xyz_mm": [0.01, 0.01, 0.02]}]}
"""
BUDGET = b"""part: part.yaml
points: [{name: P1, xyz_mm: [0, 0, 0]}]
u_ip: {sigma_mm: [0.01, 0.01, 0.02]}
u_it: {expansion_per_K: 11.0e-6, temperature_K: {half_width: 1, distribution: uniform}}
u_out: {constant_mm: 0.05, per_metre_mm: 0.02}
contributors: [{name: fixture, unit: mm, distribution: uniform, half_width: 0.02,
  degrees_of_freedom: 50, sensitivity: [1, 0, 0]}]
coverage_factor: 2
tolerance_mm: 2.0
"""
CAMPAIGN = (
    b"runs: [{run: c01/r01, clamping: 1, repeat: 1}, {run: c01/r02, clamping: 1, repeat: 2}]\n"
)
PROBE = b"""<?xml version="1.0"?><MTConnectDevices xmlns="urn:mtconnect.org:MTConnectDevices:1.5">
<Header instanceId="1" bufferSize="1000"/><Devices><Device id="d" name="mill" uuid="u">
<DataItems><DataItem category="EVENT" id="avail" type="AVAILABILITY"/></DataItems><Components>
<Axes id="a"><Components><Linear id="x" name="X"><DataItems><DataItem category="SAMPLE" id="xp"
type="POSITION" subType="ACTUAL" units="MILLIMETER" coordinateSystem="MACHINE"/></DataItems>
</Linear></Components></Axes></Components></Device></Devices></MTConnectDevices>
"""
STREAMS = b"""<?xml version="1.0"?><MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.5">
<Header instanceId="1" firstSequence="1" lastSequence="9" nextSequence="10" bufferSize="1000"/>
<Streams><DeviceStream name="mill" uuid="u"><ComponentStream component="Linear" name="X"><Samples>
<Position dataItemId="xp" sequence="7" timestamp="2026-01-01T00:00:00.123Z">12.5</Position>
</Samples></ComponentStream></DeviceStream></Streams></MTConnectStreams>
"""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A kind of input: sound samples, whether they are text, and what reads a changed one.

    ``read`` is given the changed bytes, the sound ones and a folder to work in.
    """

    name: str
    samples: tuple[bytes, ...]
    text: bool
    read: Callable[[bytes, bytes, Path], Outcome]


def _loaded(load: Callable[[Path], object], name: str) -> Callable[[bytes, bytes, Path], Outcome]:
    def read(data: bytes, _: bytes, folder: Path) -> Outcome:
        path = folder / name
        path.write_bytes(data)

        def work() -> int:
            import sys

            try:
                load(path)
            except OmmError as error:
                print(f"omm: {error}", file=sys.stderr)
                return 2
            return 0

        return observed(work)

    return read


def small_recording(folder: Path, compression: str) -> bytes:
    """Return a recording of a second: four small images, a hundred poses, all tables."""
    messages = Messages()
    random = np.random.default_rng(1)
    writer = RecordingWriter(folder / "run.mcap", RecordingOptions(compression=compression))
    for name, kind in (("/camera/image_raw", IMAGE), ("/cnc/spindle_pose", POSE)):
        writer.add_topic(
            TopicToRecord(
                name=name,
                type_name=kind,
                definition=messages.definition(kind),
                type_hash=messages.store.hash_rihs01(kind),
                qos=TopicQos(depth=5),
            )
        )
    writer.add_file("part.yaml", PART, 1)
    writer.add_file("camera.yaml", CAMERA, 1)
    writer.add_table("omm_parameters /estimator", {"model": '"7d"', "standstill_gap_s": "0.05"})
    for k in range(100):
        stamp = START_NS + k * 10_000_000
        pose = messages.pose(stamp, 0.001 * (k // 25))
        writer.write("/cnc/spindle_pose", k + 1, stamp, stamp, pose)
        if k % 25 == 12:
            pixels = random.integers(0, 60, (48, 64), dtype=np.uint8)
            image = messages.image(stamp, pixels)
            writer.write("/camera/image_raw", k // 25 + 1, stamp, stamp, image)
        if k % 20 == 19:
            writer.flush()
    path = writer.close({"ended_because": "stopped", "/cnc/spindle_pose": '{"received": 100}'})
    data = path.read_bytes()
    path.unlink()
    (folder / "metadata.yaml").unlink()
    return data


def of_others(data: bytes, folder: Path, *, chunked: bool) -> bytes:
    """Return the same messages as another program writes them: no seal, perhaps no chunks."""
    from mcap.writer import CompressionType, Writer

    path = folder / "given.mcap"
    path.write_bytes(data)
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE, use_chunking=chunked)
    writer.start("ros2", "another")
    with Recording(path) as recording:
        channels = {}
        for topic in recording.topics.values():
            schema = writer.register_schema(topic.type_name, "ros2msg", topic.definition.encode())
            channels[topic.name] = writer.register_channel(topic.name, "cdr", schema, {})
        for m in recording.messages():
            writer.add_message(
                channels[m.topic], m.log_time_ns, bytes(m.data), m.publish_time_ns, m.sequence
            )
    writer.finish()
    path.unlink()
    return out.getvalue()


def content(path: Path) -> object:
    """Return what a solution depends on."""
    with Recording(path) as recording:
        tables = {n: t for n, t in recording.metadata().items() if n.startswith("omm_parameters")}
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages()]
        for message in recording.messages():
            recording.decode(message)
        files = [recording.attachment(name) for name in ("part.yaml", "camera.yaml")]
        return messages, tables, files


def _read_recording(data: bytes, sound: bytes, folder: Path) -> Outcome:
    """Read all; what differs and was not told is a fault."""
    path = folder / "m.mcap"
    path.write_bytes(sound)
    whole = content(path)
    path.write_bytes(data)
    found: list[object] = []

    def work() -> int:
        import sys

        try:
            found.append(content(path))
        except OmmError as error:
            print(f"omm: {error}", file=sys.stderr)
            return 2
        return 0

    outcome = observed(work)
    if outcome.status == 0 and found[0] != whole and "omm: warning:" not in outcome.words:
        return Outcome(status=99, words="another content, silently", took_s=0.0, peak_bytes=0)
    return outcome


def _recording_command(words: list[str]) -> Callable[[bytes, bytes, Path], Outcome]:
    def read(data: bytes, _: bytes, folder: Path) -> Outcome:
        path = folder / "m.mcap"
        path.write_bytes(recording_with_sound_sums(data))
        return run_command([w.format(run=path, folder=folder) for w in words])

    return read


def stl() -> bytes:
    """Return a binary STL of a tetrahedron."""
    corners = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], dtype="<f4")
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    head = b"tetrahedron".ljust(80) + struct.pack("<I", len(faces))
    return head + b"".join(
        struct.pack("<3f", 0, 0, 0) + corners[list(f)].tobytes() + b"\0\0" for f in faces
    )


def ascii_stl() -> bytes:
    """Return the same kind of file as text."""
    facet = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"
    corners = ["vertex 0 0 0\n", "vertex 1 0 0\n", "vertex 0 1 0\n", "vertex 0 0 1\n"]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    body = "".join(facet.format("".join(corners[i] for i in f)) for f in faces)
    return f"solid a\n{body}endsolid a\n".encode()


def photographs() -> tuple[bytes, ...]:
    """Return one picture as PNG, JPEG, TIFF and BMP."""
    picture = np.random.default_rng(2).integers(0, 255, (40, 50), dtype=np.uint8)
    return tuple(
        bytes(cv2.imencode(kind, picture)[1].tobytes()) for kind in (".png", ".jpg", ".tif", ".bmp")
    )


def all_targets(folder: Path) -> list[Target]:
    """Return everything that is attacked; ``folder`` is for making samples."""
    from omm_cnc_bridge.controls.mtconnect.model import read_device, read_document
    from omm_cnc_bridge.controls.opcua.mapping import load_mapping
    from omm_core.budget.budget_file import load_budget_file
    from omm_core.budget.campaign_file import load_campaign_file
    from omm_core.files.calibration_set import load_calibration_set
    from omm_core.files.machine import load_machine
    from omm_core.files.part import load_part
    from omm_core.files.points import load_points
    from omm_core.files.survey import load_survey
    from omm_core.imaging.calibration import load_calibration
    from omm_core.imaging.photographs import read_grey
    from omm_core.machine.urdf import load_urdf
    from omm_core.overstock.cad import load_faces
    from omm_core.overstock.fit_file import load_fit_file

    (folder / "1.jpg").write_bytes(photographs()[1])
    (folder / "set.yaml").write_bytes(SET)
    (folder / "points.csv").write_bytes(CSV)
    runs = tuple(small_recording(folder, c) for c in ("none", "zstd", "lz4"))
    others = tuple(of_others(runs[0], folder, chunked=c) for c in (True, False))
    texts: list[tuple[str, bytes, Callable[[Path], object], str]] = [
        ("part", PART, load_part, "part.yaml"),
        ("camera", CAMERA, load_calibration, "camera.yaml"),
        ("machine", MACHINE, load_machine, "machine.yaml"),
        ("urdf", URDF, load_urdf, "mill.urdf"),
        ("mapping", MAPPING, load_mapping, "mapping.yaml"),
        ("set", SET, load_calibration_set, "set.yaml"),
        ("csv", CSV, lambda path: load_calibration_set(path.parent), "points.csv"),
        ("survey", SURVEY, load_survey, "survey.yaml"),
        ("fit", FIT, load_fit_file, "fit.yaml"),
        ("points", POINTS, load_points, "points.json"),
        ("budget", BUDGET, load_budget_file, "budget.yaml"),
        ("campaign", CAMPAIGN, load_campaign_file, "campaign.yaml"),
        ("probe", PROBE, lambda path: read_device(path.read_bytes(), ""), "probe.xml"),
        ("streams", STREAMS, lambda path: read_document(path.read_bytes()), "streams.xml"),
        ("ascii stl", ascii_stl(), load_faces, "part.stl"),
    ]
    return [
        *(Target(name=n, samples=(s,), text=True, read=_loaded(f, p)) for n, s, f, p in texts),
        Target(name="stl", samples=(stl(),), text=False, read=_loaded(load_faces, "b.stl")),
        *(
            Target(
                name=f"photograph {k}", samples=(p,), text=False,
                read=_loaded(read_grey, f"photo{k}"),
            )
            for k, p in enumerate(photographs())
        ),
        Target(name="recording", samples=runs, text=False, read=_read_recording),
        Target(
            name="recording of others", samples=others, text=False,
            read=_recording_command(["info", "{run}"]),
        ),
        *(
            Target(
                name=words[0], samples=(*runs, *others), text=False, read=_recording_command(words)
            )
            for words in (
                ["info", "{run}", "--parameters"],
                ["verify", "{run}"],
                ["repair", "{run}", "-o", "{folder}/repaired.mcap"],
                ["export", "{run}", "-o", "{folder}/export", "--plain"],
                ["solve", "{run}"],
            )
        ),
    ]  # fmt: skip

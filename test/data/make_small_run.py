"""Make a small run out of a large one: black where no target is.

python test/data/make_small_run.py RUN_FOLDER OUT     (in omm's environment)

Poses, stamps and the pixels around the targets stay as they are, so that the line can be tested
from a clone alone. The runs in `bench` and `machines` were made by a program that shares no code
with omm.
"""

import shutil
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from omm_core.files.part import load_part
from omm_core.targets import detect_targets
from omm_core.targets.coded.families import TargetFamily
from omm_recording.reading import Recording

KEPT = ("part.yaml", "camera.yaml", "truth.json")
AROUND = 3.5  # in diameters of the dot: the ring's edge lies at 1.5, the rest is background
IMAGE, POSE = "/camera/image_raw", "/cnc/spindle_pose"


def main(source: Path, target: Path) -> None:
    """Write the small run."""
    target.mkdir(parents=True, exist_ok=True)
    for name in KEPT:
        shutil.copyfile(source / name, target / name)
    family = TargetFamily.by_name(load_part(source / "part.yaml").target_family)
    store = get_typestore(Stores.ROS2_JAZZY)
    recording = Recording(source)
    # With a library that is not ours: it is a run of somebody else, without our seal.
    with (target / "run.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="")
        channels = {}
        for name in (IMAGE, POSE):
            kind = recording.topics[name].type_name
            definition = store.generate_msgdef(kind, ros_version=2)[0].encode()
            schema = writer.register_schema(kind, "ros2msg", definition)
            channels[name] = writer.register_channel(name, "cdr", schema)
        for number, message in enumerate(recording.messages((IMAGE, POSE))):
            data = bytes(message.data)
            if message.topic == IMAGE:
                data = _only_targets(data, family, store)
            writer.add_message(
                channels[message.topic],
                message.log_time_ns,
                data,
                message.publish_time_ns,
                sequence=number,
            )
        writer.finish()


def _only_targets(data: bytes, family: TargetFamily, store: object) -> bytes:
    kind = "sensor_msgs/msg/Image"
    message = store.deserialize_cdr(data, kind)  # type: ignore[attr-defined]
    pixels = np.array(message.data).reshape(message.height, message.step)[:, : message.width]
    kept = np.zeros_like(pixels)
    for found in detect_targets(pixels, family).targets:
        radius = round(AROUND * found.diameter_px)
        col, row = (round(float(c)) for c in found.center_px)
        rows = slice(max(0, row - radius), row + radius)
        cols = slice(max(0, col - radius), col + radius)
        kept[rows, cols] = pixels[rows, cols]
    message.data = kept.reshape(-1)
    message.step = message.width
    return bytes(store.serialize_cdr(message, kind))  # type: ignore[attr-defined]


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

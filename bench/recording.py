"""How fast recording is: against a raw file and a plain MCAP writer, and through ROS.

    ./omm exec python bench/recording.py            the writers, in one run
    ./omm exec python bench/recording.py --live 60  besides: 15 images/s of 5 MP for 60 s, recorded
                                                    while camera, spindle and estimator run
    ./omm exec python bench/recording.py --alone 20 besides: how many images/s the recorder takes
                                                    when it runs alone

All writers write the same images to the same folder, in turn, several times; the median counts.
`--images RUN` takes the images from a recording instead of synthetic ones.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

IMAGE = "sensor_msgs/msg/Image"
SHAPE = (1944, 2592)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--images", metavar="RUN", type=Path)
    parser.add_argument("--folder", type=Path, help="where to write (default: a temporary one)")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--live", metavar="S", type=float)
    parser.add_argument("--alone", metavar="S", type=float)
    parser.add_argument("--rate", type=float, default=15.0)
    parser.add_argument("--compression", default="zstd")
    parser.add_argument("--publish", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish:
        return publish(*arguments.publish, arguments.images)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        if arguments.live:
            live(Path(folder), arguments)
        elif arguments.alone:
            alone(Path(folder), arguments)
        else:
            writers(Path(folder), images(arguments.images), arguments.rounds)
    return 0


def images(run: Path | None) -> list[np.ndarray]:
    """Eight images (H, W) uint8: from a recording, or dark ones with noise and bright dots."""
    if run is not None:
        from omm_recording.decoding import image_pixels
        from omm_recording.reading import Recording

        with Recording(run) as recording:
            topic = recording.messages(["/camera/image_raw"])
            return [image_pixels(recording.decode(m)).copy() for m in topic][:8]
    random = np.random.default_rng(1)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    result = []
    for _ in range(8):
        light = 10.0 + random.normal(0.0, 2.0, SHAPE)
        for row, col in random.uniform(200, 1700, (12, 2)):
            light += 150.0 * ((rows - row) ** 2 + (cols - col) ** 2 < 40.0**2)
        result.append(np.clip(light, 0, 255).astype(np.uint8))
    return result


# --- the writers alone ------------------------------------------------------------------------


def serialised(pixels: list[np.ndarray]) -> tuple[list[bytes], str]:
    """Return the images as ROS messages, and the definition of their type."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id="camera_optical"
    )
    messages = [
        types[IMAGE](
            header=header,
            height=p.shape[0],
            width=p.shape[1],
            encoding="mono8",
            is_bigendian=0,
            step=p.shape[1],
            data=p.reshape(-1),
        )
        for p in pixels
    ]
    data = [bytes(store.serialize_cdr(message, IMAGE)) for message in messages]
    return data, store.generate_msgdef(IMAGE, ros_version=2)[0]


def writers(folder: Path, pixels: list[np.ndarray], rounds: int) -> None:
    data, definition = serialised(pixels)
    data = data * 4
    size_mb = sum(map(len, data)) / 1e6
    ways: dict[str, Callable[[Path], Path]] = {
        "raw file": lambda path: write_raw(path, data),
        "mcap library, not chunked": lambda path: write_mcap(path, data, definition, "NONE", False),
        "mcap library, none": lambda path: write_mcap(path, data, definition, "NONE"),
        "mcap library, lz4": lambda path: write_mcap(path, data, definition, "LZ4"),
        "mcap library, zstd": lambda path: write_mcap(path, data, definition, "ZSTD"),
        "omm, none": lambda path: write_omm(path, data, definition, "none"),
        "omm, lz4": lambda path: write_omm(path, data, definition, "lz4"),
        "omm, zstd": lambda path: write_omm(path, data, definition, "zstd"),
    }
    wall: dict[str, list[float]] = {name: [] for name in ways}
    cpu: dict[str, list[float]] = {name: [] for name in ways}
    ratio = {}
    for number in range(rounds):
        # Another one first in each round: what the disk did before counts too.
        names = [*ways][number % len(ways) :] + [*ways][: number % len(ways)]
        for name in names:
            way = ways[name]
            path = folder / f"{number}.mcap"
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            written = way(path)
            wall[name].append(size_mb / (time.perf_counter() - wall_s))
            cpu[name].append(size_mb / (time.process_time() - cpu_s))
            ratio[name] = written.stat().st_size / 1e6 / size_mb
            written.unlink()
            (folder / "metadata.yaml").unlink(missing_ok=True)
            os.sync()
    print(f"{len(data)} images, {size_mb:.0f} MB, median of {rounds}")
    print(f"{'':<28}{'MB/s':>8}{'MB/s CPU':>10}{'size':>7}")
    for name in ways:
        speed, work = statistics.median(wall[name]), statistics.median(cpu[name])
        print(f"{name:<28}{speed:8.0f}{work:10.0f}{ratio[name]:7.2f}")


def write_raw(path: Path, data: list[bytes]) -> Path:
    with path.open("wb", buffering=0) as file:
        for message in data:
            file.write(message)
    return path


def write_mcap(
    path: Path, data: list[bytes], definition: str, compression: str, chunked: bool = True
) -> Path:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression], use_chunking=chunked)
        writer.start(profile="ros2")
        schema = writer.register_schema(IMAGE, "ros2msg", definition.encode())
        channel = writer.register_channel("/camera/image_raw", "cdr", schema)
        for number, message in enumerate(data):
            writer.add_message(channel, number, message, number, number)
        writer.finish()
    return path


def write_omm(path: Path, data: list[bytes], definition: str, compression: str) -> Path:
    """With checksums, the chain of links, and what reaches the disk every half second."""
    from omm_recording.rosbag2_format import TopicQos
    from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord

    writer = RecordingWriter(path, RecordingOptions(compression=compression))
    topic = TopicToRecord(
        name="/camera/image_raw",
        type_name=IMAGE,
        definition=definition,
        type_hash="",
        qos=TopicQos(),
    )
    writer.add_topic(topic)
    for number, message in enumerate(data):
        writer.write(topic.name, number, number, number, message)
    return writer.close({})


# --- through ROS ------------------------------------------------------------------------------


def live(folder: Path, arguments: argparse.Namespace) -> None:
    """Camera, spindle, estimator and recorder as separate processes; what arrives is counted."""
    nodes = []
    part = arguments.images
    if part is not None and (part / "part.yaml").is_file():
        files = [f"part_file:={part / 'part.yaml'}", f"calibration_file:={part / 'camera.yaml'}"]
        nodes.append(start("estimator", "omm_estimator.node", files))
    report(folder, arguments, nodes, arguments.live, arguments.rate)


def alone(folder: Path, arguments: argparse.Namespace) -> None:
    """Faster and faster, until something is lost."""
    for rate in (15.0, 30.0, 45.0, 60.0, 75.0):
        place = folder / f"{rate:.0f}"
        if report(place, arguments, [], arguments.alone, rate):
            break


def report(
    folder: Path,
    arguments: argparse.Namespace,
    nodes: list[tuple[str, "subprocess.Popen[str]"]],
    duration_s: float,
    rate: float,
) -> int:
    """Run it, print what became of it; returns how many messages were lost."""
    from omm_recording.inspecting import inspect

    settings = [f"folder:={folder}", f"compression:={arguments.compression}"]
    nodes = [start("recorder", "omm_recorder.node", settings), *nodes]
    time.sleep(3.0)
    command = [sys.executable, __file__, "--publish", str(duration_s), str(rate)]
    if arguments.images is not None:
        command += ["--images", str(arguments.images)]
    publisher = subprocess.run(command, check=True, capture_output=True, text=True)
    sent = json.loads(publisher.stdout.splitlines()[-1])
    time.sleep(1.0)
    used_s = {name: cpu_s(process.pid) for name, process in nodes}
    for name, process in reversed(nodes):
        if process.poll() is not None:
            raise SystemExit(f"{name} has died (status {process.returncode})")
        process.send_signal(signal.SIGINT)
    for _, process in reversed(nodes):
        process.communicate(timeout=120)
    summary = inspect(folder / "run.mcap")
    by_name = {topic.name: topic for topic in summary.topics}
    lost = 0
    print(
        f"{rate:.0f} images/s asked, {sent['images'] / sent['seconds']:.1f} published for "
        f"{sent['seconds']:.0f} s ({sent['megabytes'] / sent['seconds']:.0f} MB/s), "
        f"{summary.size_bytes / 1e6:.0f} MB written, compression {arguments.compression}"
    )
    for name, number in (("/camera/image_raw", "images"), ("/cnc/spindle_pose", "poses")):
        recorded = by_name[name].messages or 0
        lost += sent[number] - recorded
        print(f"  {name}: {sent[number]} published, {recorded} recorded, {by_name[name].tally}")
    shares = {**used_s, "publisher": sent["cpu_s"]}
    print(f"  waited for the disk at most: {summary.queue_peak_bytes / 1e6:.0f} MB")
    print("  processor:", ", ".join(f"{n} {s / sent['seconds']:.0%}" for n, s in shares.items()))
    sys.stdout.flush()
    return lost


def start(name: str, module: str, settings: list[str]) -> tuple[str, "subprocess.Popen[str]"]:
    words = [word for setting in settings for word in ("-p", setting)]
    code = f"import sys; from {module} import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *words], stderr=subprocess.DEVNULL, text=True
    )
    return name, process


def cpu_s(pid: int) -> float:
    """User and system time of a process."""
    values = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def publish(duration: str, rate: str, run: Path | None) -> int:
    """Be the camera and the spindle in one process: images at a rate, poses at 100 Hz."""
    from omm_ros import transport

    transport.prepare()
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import Image

    from omm_ros import qos
    from omm_ros.conversions import image_message

    pixels = images(run)
    rclpy.init()
    node = rclpy.create_node("bench_publisher")
    to_images = node.create_publisher(Image, "/camera/image_raw", qos.IMAGE)
    to_poses = node.create_publisher(PoseStamped, "/cnc/spindle_pose", qos.POSE)
    while not (to_images.get_subscription_count() and to_poses.get_subscription_count()):
        time.sleep(0.05)
    time.sleep(1.0)
    pose = PoseStamped()
    pose.header.frame_id = "machine"
    pose.pose.orientation.w = 1.0
    sent, poses = 0, 0
    start_s = time.monotonic()
    cpu_start_s = time.process_time()
    while (now_s := time.monotonic() - start_s) < float(duration):
        if now_s * 100.0 >= poses:
            pose.header.stamp = node.get_clock().now().to_msg()
            to_poses.publish(pose)
            poses += 1
        if now_s * float(rate) >= sent:
            to_images.publish(image_message(pixels[sent % 8], time.time_ns(), "camera_optical"))
            sent += 1
        due_s = min(poses / 100.0, sent / float(rate)) - (time.monotonic() - start_s)
        time.sleep(max(0.0, due_s))
    seconds = time.monotonic() - start_s
    used_s = time.process_time() - cpu_start_s
    time.sleep(2.0)
    size_mb = sent * pixels[0].size / 1e6
    figures = {"images": sent, "poses": poses, "seconds": seconds}
    print(json.dumps({**figures, "megabytes": size_mb, "cpu_s": used_s}))
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

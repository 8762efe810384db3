"""A few of the attacks of `bench/hostile.py`, with fixed seeds: no traceback, no silent change."""

import re
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
from hostile_inputs import mutated, run_command
from hostile_targets import CAMERA, PART, Target, all_targets
from recorded_samples import IMAGE, POSE, Messages
from whole_suite import ROOT

from omm_recording.rosbag2_format import TopicQos
from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord

INPUTS = 24
READ = {"verify": (0, 2), "solve": (1,)}
"""What commands say to the sound samples: others' have no seal, and no target is in the images."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hostile")


@pytest.fixture(scope="module")
def targets(folder: Path) -> list[Target]:
    return all_targets(folder)


def cleared(folder: Path) -> None:
    (folder / "repaired.mcap").unlink(missing_ok=True)
    shutil.rmtree(folder / "export", ignore_errors=True)


def test_what_is_attacked_is_read_where_it_is_sound(targets: list[Target], folder: Path) -> None:
    for target in targets:
        for sample in target.samples:
            outcome = target.read(sample, sample, folder)
            cleared(folder)
            assert outcome.status in READ.get(target.name, (0,)), f"{target.name}: {outcome.words}"


@pytest.mark.filterwarnings("default")
def test_changed_files_end_in_a_result_or_a_message(targets: list[Target], folder: Path) -> None:
    for target in targets:
        random = np.random.default_rng(zlib.crc32(target.name.encode()))
        for number in range(INPUTS):
            sample = target.samples[number % len(target.samples)]
            data = mutated(sample, random, text=target.text)
            fault = target.read(data, sample, folder).fault()
            cleared(folder)
            assert not fault, f"{target.name}, input {number}: {fault}"


READERS = re.compile(r"\.read_text\(|\.read_bytes\(|yaml\.(safe_)?load\(|ET\.parse\(|json\.load\(")
OWN = {
    "omm_core/files/outside.py": "the reader itself",
    "omm_core/files/strict_yaml.py": "the reader itself",
    "omm_cnc_bridge/controls/linuxcnc/cell.py": "/proc, and what our LinuxCNC writes",
    "omm_kernels/compiling.py": "our own stamps and sources",
    "omm_operator/web/handlers.py": "the page's own files, by a fixed table",
    "omm_operator/ros_actions.py": "the report that it has just made",
    "omm_core/overstock/step_file.py": "after a limit of its size; what the reader has just made",
    "omm_recorder/definitions.py": "definitions that ROS has installed",
    "omm_recorder/recording_state.py": "/proc/meminfo",
    "omm_runs/solving.py": "compared with the file inside, after it was read",
    "omm_runs/calibrating.py": "the checksum of a set that was read",
    "omm_simulation/cell.py": "a part file that it has just written",
    "omm_report/run_evidence.py": "files that the solution was made of",
    "omm_report/language.py": "its own words",
    "omm_bringup/processes.py": "the log of a node that it started",
    "omm_bringup/commands/doctor.py": "/proc",
    "omm_camera_driver/drivers/usb3/sysfs.py": "/sys",
}


def test_files_from_outside_have_one_way_in() -> None:
    """Bounded, of ordinary files, strict: a reader beside it would be a way around all that."""
    found = set()
    for path in sorted((ROOT / "ros2_ws" / "src").glob("omm_*/omm_*/**/*.py")):
        if READERS.search(path.read_text()):
            found.add("/".join(path.relative_to(ROOT / "ros2_ws" / "src").parts[1:]))
    assert found - set(OWN) == set()


TABLES = {
    "no JSON": {"model": "{"},
    "another model": {"model": '"9d"'},
    "a word for a number": {"significance": '"high"'},
    "no number": {"standstill_tolerance_mm": "NaN"},
    "infinity": {"standstill_gap_s": "1e999"},
    "truth for a number": {"max_dot_diameter_px": "true"},
    "deep nesting": {"model": "[" * 100_000},
    "thousands of digits": {"significance": "9" * 5000},
}


@pytest.mark.parametrize("kind", TABLES)
def test_settings_that_no_estimator_has_are_refused(kind: str, tmp_path: Path) -> None:
    path = small_run(tmp_path, "omm_parameters /estimator", TABLES[kind])
    outcome = run_command(["solve", str(path)])
    assert outcome.status == 2, outcome.words
    assert not outcome.fault()


def test_counts_that_are_none_are_told_and_left_out(tmp_path: Path) -> None:
    told = {"/cnc/spindle_pose": '{"received": "many", "longest_pause_s": []}'}
    path = small_run(tmp_path, "omm_report", told | {"queue_peak_bytes": "x"})
    outcome = run_command(["info", str(path)])
    assert outcome.status == 0, outcome.words
    assert "omm: warning:" in outcome.words


def small_run(folder: Path, table: str, values: dict[str, str]) -> Path:
    """Record poses, images and one table of anything."""
    messages = Messages()
    writer = RecordingWriter(folder / "run.mcap", RecordingOptions())
    for name, kind in (("/camera/image_raw", IMAGE), ("/cnc/spindle_pose", POSE)):
        definition, sums = messages.definition(kind), messages.store.hash_rihs01(kind)
        writer.add_topic(
            TopicToRecord(
                name=name, type_name=kind, definition=definition, type_hash=sums, qos=TopicQos()
            )
        )
    writer.add_file("part.yaml", PART, 1)
    writer.add_file("camera.yaml", CAMERA, 1)
    writer.add_table(table, values)
    writer.write("/cnc/spindle_pose", 1, 1, 1, messages.pose(1, 0.0))
    pixels = np.zeros((48, 64), dtype=np.uint8)
    writer.write("/camera/image_raw", 1, 1, 1, messages.image(1, pixels))
    return writer.close({})

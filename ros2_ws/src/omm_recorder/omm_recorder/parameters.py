"""Parameters of the recorder."""

from dataclasses import dataclass

from omm_recording.mcap_writer import COMPRESSIONS
from omm_ros.parameters import network_parameter, parameter


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """All can be given at the start only: a recording is made in one way from end to end."""

    folder: str = parameter(
        "", "Folder to record into as run.mcap; empty: a new one in runs/, named by the time."
    )
    compression: str = parameter(
        "zstd",
        "Compression of chunks: none is the fastest, zstd halves the size. Images stay exact.",
        choices=COMPRESSIONS,
    )
    topics: tuple[str, ...] = parameter(
        (), "Topics to record besides those of omm; their types are found when they appear."
    )
    all_topics: bool = parameter(False, "Record every topic there is.")
    part_file: str = parameter(
        "", "Part file to put into the recording; empty: the one that the estimator uses."
    )
    calibration_file: str = parameter(
        "", "Calibration file to put into the recording; empty: the one that the estimator uses."
    )
    machine_file: str = parameter(
        "", "Machine file to put into the recording; empty: the one that the estimator uses."
    )
    key_file: str = parameter(
        "", "Private key (Ed25519, PEM or OpenSSH) to sign the recording with; empty: unsigned."
    )
    queue_mb: int = parameter(
        2048,
        "What may wait in memory for the disk before messages are lost (MB); "
        "at most a quarter of the memory that is available.",
        minimum=16,
    )
    warn_left_min: float = parameter(
        10.0, "Warn when the disk will be full in less than this (minutes).", minimum=0.0
    )
    stop_free_mb: int = parameter(
        64, "Stop cleanly when less than this is free on the disk (MB).", minimum=1
    )
    network: bool = network_parameter()

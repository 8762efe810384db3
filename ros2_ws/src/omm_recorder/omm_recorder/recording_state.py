"""When a recording warns and stops, and how it is doing."""

import os
from dataclasses import dataclass
from pathlib import Path

from omm_core.words import Words


@dataclass(frozen=True, kw_only=True)
class Limits:
    """When to warn and when to stop."""

    queue_bytes: int = 2 << 30
    """What may wait for the disk; at most a quarter of the memory that is available."""
    warn_left_s: float = 600.0
    """Warn when the disk is full in less than this."""
    stop_free_bytes: int = 64 << 20
    """Stop, cleanly, when less than this is free."""


@dataclass(frozen=True, kw_only=True)
class RecordingState:
    """How the recording is doing."""

    recording: bool
    ended_because: str
    """Empty while recording; ``stopped`` where it was told to."""
    trouble: Words
    """What is wrong, for people; empty when all is well."""
    bytes_written: int
    queue_bytes: int
    free_bytes: int
    left_s: float
    """Until the disk is full at the present rate; infinite while nothing is written."""
    bytes_per_s: float
    received: int
    lost: int
    missing: int


def available_memory() -> int:
    """Return the bytes that programs can still get, as the kernel estimates."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) << 10
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2

"""Where a campaign comes from: recorded runs, a simulation, or live nodes."""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from omm_core.budget.campaign import Campaign, evaluate_campaign
from omm_core.errors import InputError
from omm_runs.campaigning import campaign_of, full_widths
from omm_runs.spreading import spread

_BLOCK = 50  # clampings that a worker simulates at a time


def campaign_and_source(arguments: argparse.Namespace) -> tuple[Campaign, str]:
    """Return the campaign that the command line asks for, and what it is made of in words.

    Raises
    ------
    InputError
        Where the options contradict each other.
    """
    spread_over = {"jobs": arguments.jobs, "scheduler": arguments.scheduler, "progress": _show}
    if (arguments.campaign is None) == (arguments.clampings is None):
        raise InputError("Expected either CAMPAIGN.yaml or --clampings K.")
    if arguments.campaign is not None:
        return campaign_of(arguments.campaign, **spread_over)[0], str(arguments.campaign)
    measurements = arguments.clampings * arguments.repeats
    if min(arguments.clampings, arguments.repeats) < 1 or measurements < 2:
        raise InputError("Expected at least 2 measurements: more --clampings or --repeats.")
    if arguments.live:
        path = _driven(arguments)
        return campaign_of(path, **spread_over)[0], str(path)
    if arguments.camera is not None:
        raise InputError("--camera is for a campaign that is measured: add --live.")
    return (
        _simulated(arguments, spread_over),
        f"simulation, scenario {arguments.scenario}, seed {arguments.seed}",
    )


def _driven(arguments: argparse.Namespace) -> Path:
    from omm_ros import transport
    from omm_ros.environment import check_environment

    check_environment(discovery=False)
    transport.prepare()
    from rich.console import Console

    from omm_bringup.live_campaign import LiveCampaign, drive

    campaign = LiveCampaign(
        folder=arguments.folder or Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-campaign",
        clampings=arguments.clampings,
        repeats=arguments.repeats,
        scenario=arguments.scenario,
        seed=arguments.seed,
        station=_station(arguments),
    )
    return drive(campaign, Console(stderr=True))


def _station(arguments: argparse.Namespace) -> dict[str, str] | None:
    """Return the arguments of a real machine's nodes, or None for the simulated cell."""
    if arguments.camera is None:
        return None
    needed = ("control", "part", "calibration")
    missing = [f"--{name}" for name in needed if getattr(arguments, name) is None]
    if missing:
        raise InputError(f"--camera needs {', '.join(missing)}, too.")
    return {
        "camera": arguments.camera,
        "control": arguments.control,
        "part_file": str(arguments.part),
        "calibration_file": str(arguments.calibration),
        "machine_file": "" if arguments.machine is None else str(arguments.machine),
    }


def _simulated(arguments: argparse.Namespace, spread_over: dict[str, Any]) -> Campaign:
    from omm_simulation.clampings import ClampingSettings, measure_clampings
    from omm_simulation.scenario import load_scenario

    settings = ClampingSettings(
        scenario=arguments.scenario,
        seed=arguments.seed,
        repeats=arguments.repeats,
        noise_px=arguments.noise_px,
        images=arguments.images,
    )
    scenario = load_scenario(settings.scenario)
    size = 1 if settings.images else max(1, min(_BLOCK, arguments.clampings // 8))
    numbers = range(1, arguments.clampings + 1)
    blocks = [numbers[first : first + size] for first in range(0, len(numbers), size)]
    found = spread(partial(measure_clampings, settings), blocks, **spread_over)
    measured = [one for block in found for one in block]
    return evaluate_campaign(measured, tolerances=full_widths(scenario.part))


def _show(done: int, total: int) -> None:
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\r\033[Komm: {done} of {total}", end=end, file=sys.stderr, flush=True)

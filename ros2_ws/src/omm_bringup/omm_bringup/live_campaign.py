"""A campaign driven live: every run its own recording, the operator told when to clamp anew."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from omm_bringup.cell import simulated_cell
from omm_bringup.isolation import own_domain
from omm_bringup.processes import NodeSpec, check_alive, running
from omm_bringup.station import station
from omm_core.errors import InputError, MeasurementError
from omm_core.files.output import take_folder, write_whole

Ask = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class LiveCampaign:
    """What is driven.

    Attributes
    ----------
    folder : Path
        Holds a folder for each run, c01/r01, and campaign.yaml.
    scenario, seed : str, int
        Of the simulated cell, where ``station`` is None.
    station : dict or None
        Of a real machine: the arguments of `omm_bringup.station.station`.
    """

    folder: Path
    clampings: int
    repeats: int
    scenario: str = "bench"
    seed: int = 1
    station: dict[str, Any] | None = None


def drive(campaign: LiveCampaign, console: Console, ask: Ask | None = None) -> Path:
    """Measure the missing runs; return campaign.yaml, which names them.

    A campaign that was interrupted goes on where it was: a clamping begun is then clamped anew.

    Parameters
    ----------
    ask : callable
        Tells the operator what to do and returns when it is done; default: waits for Enter.

    Raises
    ------
    InputError
        Where nobody is there to be asked.
    MeasurementError
        Where a run does not come to an end.
    """
    take_folder(campaign.folder)
    if campaign.station is not None and ask is None and not sys.stdin.isatty():
        raise InputError("A campaign on a machine needs an operator: run it in a terminal.")
    done: list[dict[str, str | int]] = []
    clamped = 0
    for clamping in range(1, campaign.clampings + 1):
        for repeat in range(1, campaign.repeats + 1):
            name = f"c{clamping:02d}/r{repeat:02d}"
            if not (campaign.folder / name / "run.mcap").exists():
                if clamped != clamping:
                    _clamp(campaign, clamping, console, ask or _enter)
                    clamped = clamping
                console.print(f"omm: clamping {clamping}, repeat {repeat}: {name}")
                _measure(campaign, campaign.folder / name, clamping, repeat, console)
            done.append({"run": name, "clamping": clamping, "repeat": repeat})
            # Anew after each run: what is measured counts, whatever happens next.
            text = yaml.safe_dump({"runs": done}, sort_keys=False)
            write_whole(campaign.folder / "campaign.yaml", text)
    return campaign.folder / "campaign.yaml"


def _clamp(campaign: LiveCampaign, clamping: int, console: Console, ask: Ask) -> None:
    words = (
        "clamp the camera in the spindle"
        if clamping == 1
        else "unclamp the camera, take it out of the spindle, clamp it again"
    )
    if campaign.station is None:
        console.print(f"omm: clamping {clamping}: the operator would now {words}")
    else:
        ask(f"Clamping {clamping} of {campaign.clampings}: {words}. The part stays as it is.")


def _enter(words: str) -> None:
    input(f"{words} Then press Enter. ")


def _measure(
    campaign: LiveCampaign, folder: Path, clamping: int, repeat: int, console: Console
) -> None:
    from omm_operator.measuring import measure_alone

    specs = _specs(campaign, folder, clamping, repeat)
    with own_domain(), running(specs, folder / "log") as nodes:
        estimate = measure_alone(
            console, lambda: check_alive(nodes), by_hand=campaign.station is not None
        )
    if not estimate.determined:
        (folder / "run.mcap").rename(folder / "failed.mcap")
        raise MeasurementError(
            f"{folder} has no result: {'; '.join(estimate.missing) or 'not determined'}. Its"
            " recording is failed.mcap; start the campaign again to go on with it."
        )


def _specs(campaign: LiveCampaign, folder: Path, clamping: int, repeat: int) -> Sequence[NodeSpec]:
    folder.mkdir(parents=True, exist_ok=True)
    if campaign.station is not None:
        return station(**campaign.station, folder=str(folder.resolve()))
    from omm_simulation.cell import draw, write_estimator_files, write_truth
    from omm_simulation.scenario import load_scenario

    seed = campaign.seed + clamping
    cell = draw(load_scenario(campaign.scenario), campaign.seed, clamping_seed=seed, repeat=repeat)
    write_estimator_files(cell, folder)
    write_truth(cell, folder / "truth.json")
    return simulated_cell(
        folder.resolve(),
        scenario=campaign.scenario,
        seed=campaign.seed,
        clamping_seed=seed,
        repeat=repeat,
    )

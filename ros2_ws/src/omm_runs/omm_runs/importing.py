"""Takes the lens of a calibration that another program wrote."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from omm_core.camera_calibration.importing import import_lens
from omm_core.errors import InputError
from omm_core.files.camera_writing import lens_yaml
from omm_core.files.foreign_calibration import read_foreign
from omm_core.files.sensor import NamedSensor, PlumbBobIntrinsics


def import_calibration(path: Path) -> tuple[str, dict[str, Any], list[str]]:
    """Return the lens block of camera.yaml, the same as JSON, and the lines to print.

    Raises
    ------
    InputError
        If the file is not a known kind of calibration, or its lens cannot be converted.
    """
    foreign = read_foreign(path)
    try:
        imported = import_lens(foreign)
    except InputError as error:
        raise InputError(f"{path}, a calibration of {foreign.source}: {error}") from None
    intrinsics = asdict(imported.lens)
    size = {name: intrinsics.pop(name) for name in ("width_px", "height_px")}
    text = lens_yaml(
        sensor=NamedSensor(name=foreign.name, **size),
        intrinsics=PlumbBobIntrinsics(**intrinsics),
        source=foreign.source,
        largest_error_px=imported.largest_error_px,
    )
    told = {
        "source": foreign.source,
        "model": "plumb_bob",
        "intrinsics": intrinsics,
        **size,
        "largest_error_px": imported.largest_error_px,
        "findings": list(imported.findings),
    }
    lines = [
        f"{foreign.name}: a calibration of {foreign.source}, {foreign.width_px} x"
        f" {foreign.height_px} pixels; taken as plumb_bob, largest error"
        f" {imported.largest_error_px:.2g} px",
        *(f"  {name:<6} {value:.9g}" for name, value in intrinsics.items()),
        *(f"finding: {words}" for words in imported.findings),
    ]
    return text, told, lines

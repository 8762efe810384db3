"""A campaign is of one part, each measurement once; another calibration is told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omm_core.budget.campaign import MeasuredRun
from omm_core.errors import InputError
from omm_core.files.part import Part, Target
from omm_runs import campaigning
from omm_runs.campaigning import campaign_of

PART = Part(
    name="block",
    target_family="aicon12",
    targets=tuple(
        Target(id=i, xyz_mm=np.array(xyz), dot_diameter_mm=5.0)
        for i, xyz in enumerate([[0.0, 0, 0], [900.0, 0, 0], [0, 700.0, 0]], start=1)
    ),
)
CAMERA = (6.189, -8.7)


def solved(number: int):  # type: ignore[no-untyped-def]
    theta = np.random.default_rng(number).normal(size=7) * 1e-3
    one = MeasuredRun(
        clamping=number, repeat=1, theta=theta, covariance=np.eye(7) * 1e-6, name=f"run {number}"
    )
    return one, PART, CAMERA


def campaign(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, found):  # type: ignore[no-untyped-def]
    (tmp_path / "campaign.yaml").write_text(
        "runs: [{run: a, clamping: 1, repeat: 1}, {run: b, clamping: 2, repeat: 1}]"
    )
    monkeypatch.setattr(campaigning, "spread", lambda *_, **__: found)
    return campaign_of(tmp_path)[0]


def test_runs_of_one_part_are_a_campaign(monkeypatch, tmp_path) -> None:  # type: ignore[no-untyped-def]
    found = campaign(monkeypatch, tmp_path, [solved(1), solved(2), solved(3)])
    assert found.clampings == 3
    assert found.findings == ()


def test_another_part_is_refused_by_name(monkeypatch, tmp_path) -> None:  # type: ignore[no-untyped-def]
    first, second = solved(1), solved(2)
    moved = replace(PART.targets[0], xyz_mm=np.array([0.0, 0.1, 0.0]))
    others = (replace(PART, targets=(moved, *PART.targets[1:])), replace(PART, targets=(moved,)))
    for other in others:
        with pytest.raises(InputError, match="the targets of run 2 are not those of run 1"):
            campaign(monkeypatch, tmp_path, [first, (second[0], other, CAMERA)])


def test_a_copy_of_a_run_is_no_second_measurement(monkeypatch, tmp_path) -> None:  # type: ignore[no-untyped-def]
    one, part, camera = solved(1)
    copy = (replace(one, clamping=2, name="run 2"), part, camera)
    with pytest.raises(InputError, match="is it a copy"):
        campaign(monkeypatch, tmp_path, [(one, part, camera), copy])


def test_several_calibrations_are_told(monkeypatch, tmp_path) -> None:  # type: ignore[no-untyped-def]
    found = campaign(monkeypatch, tmp_path, [solved(1), (*solved(2)[:2], (6.19, -8.7))])
    assert "2 different calibrations" in found.findings[0]

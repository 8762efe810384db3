"""./omm campaign: the paper's tables in simulation, on all cores and over Dask, and from runs."""

import json

import numpy as np
import pytest

from omm_bringup.command_line import main


def measured(tmp_path, *arguments):
    out = tmp_path / "out.json"
    assert main(["campaign", "--json", str(out), "--jobs", "1", *arguments]) == 0
    return json.loads(out.read_text())


def test_7d_takes_the_backlash_out_of_x_and_y(tmp_path, capsys):
    found = measured(
        tmp_path, "--scenario", "ideal", "--clampings", "10", "--repeats", "3", "--seed", "3"
    )
    six, seven = found["table_2"], found["table_3"]
    assert six["x_mm"] > 10 * seven["x_mm"]
    assert six["y_mm"] > 10 * seven["y_mm"]
    assert six["gamma_s_mm_per_m"] is None
    # The holder's play is uniform over 6.15 mm/m: 2σ = 3.55.
    assert 2.0 < seven["gamma_s_mm_per_m"] < 5.0
    assert found["prediction"]["believed"]
    assert found["clampings"] == 10
    assert found["repeats"] == [3] * 10
    assert "7D, table 3" in capsys.readouterr().out


def test_equal_seeds_give_equal_campaigns_however_it_is_spread(tmp_path):
    few = ["--clampings", "6", "--repeats", "2", "--seed", "5"]
    assert measured(tmp_path, *few) == measured(tmp_path, *few, "--jobs", "2")


def test_a_local_dask_cluster_of_two_workers_gives_the_same(tmp_path):
    distributed = pytest.importorskip("distributed", reason="Dask is not installed here")
    few = ["--clampings", "4", "--repeats", "2"]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        spread = measured(tmp_path, *few, "--scheduler", cluster.scheduler_address)
    assert spread == measured(tmp_path, *few)


def test_rendered_images_give_a_campaign_too(tmp_path):
    found = measured(tmp_path, "--scenario", "ideal", "--clampings", "2", "--images")
    errors = [[run["theta"][key] for key in ("x_mm", "y_mm", "z_mm")] for run in found["runs"]]
    assert np.ptp(errors, axis=0).max() < 0.05


@pytest.mark.parametrize(
    "bad",
    [
        [],
        ["--clampings", "1"],
        ["--clampings", "0", "--repeats", "5"],
        ["--clampings", "3", "--noise-px", "0"],
        ["--clampings", "3", "--repeats", "0"],
        ["nowhere.yaml"],
        ["nowhere.yaml", "--clampings", "3"],
    ],
)
def test_what_makes_no_sense_is_refused(bad):
    try:
        status = main(["campaign", *bad])
    except SystemExit as left:  # argparse ends so for a number out of range
        status = left.code
    assert status == 2


def test_a_scheduler_that_is_not_there_is_told(capsys):
    pytest.importorskip("distributed", reason="Dask is not installed here")
    assert main(["campaign", "--clampings", "3", "--scheduler", "tcp://127.0.0.1:9"]) == 1
    assert "does not answer" in capsys.readouterr().err

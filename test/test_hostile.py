"""A few of the attacks of `bench/hostile.py`, with fixed seeds: no traceback, no silent change."""

import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
from hostile_inputs import mutated
from hostile_targets import Target, all_targets

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

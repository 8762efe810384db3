"""Attack everything that omm reads with changed files, as many as are asked for.

    ./omm exec python bench/hostile.py [--inputs 20000] [--seed 1] [--only NAME] [--keep FOLDER]

Every input must end in a result or in a message within 10 s and 1 GB; a recording must give the
same content, or say what was wrong. Faults are counted by what they are; one example of each is
kept. The status is 1 where there is any.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

from hostile_inputs import mutated
from hostile_targets import Target, all_targets


def main() -> int:
    """Run the attack."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", help="a kind of input; may be repeated")
    parser.add_argument("--keep", type=Path, default=Path("hostile"), help="for examples of faults")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        targets = [t for t in all_targets(folder) if t.name in (arguments.only or [t.name])]
        return attack(targets, folder, arguments)


def attack(targets: list[Target], folder: Path, arguments: argparse.Namespace) -> int:
    """Give the targets their share of the inputs in turn."""
    random = np.random.default_rng(arguments.seed)
    faults: Counter[tuple[str, str]] = Counter()
    statuses: Counter[tuple[str, int | None]] = Counter()
    longest = {target.name: 0.0 for target in targets}
    largest = {target.name: 0 for target in targets}
    started_s = time.monotonic()
    for number in range(arguments.inputs):
        target = targets[number % len(targets)]
        sample = target.samples[int(random.integers(len(target.samples)))]
        data = mutated(sample, random, text=target.text)
        outcome = target.read(data, sample, folder)
        (folder / "repaired.mcap").unlink(missing_ok=True)
        shutil.rmtree(folder / "export", ignore_errors=True)
        statuses[target.name, outcome.status] += 1
        longest[target.name] = max(longest[target.name], outcome.took_s)
        largest[target.name] = max(largest[target.name], outcome.peak_bytes)
        if fault := outcome.fault():
            lines = fault.strip().splitlines()
            places = [line.strip() for line in lines if line.strip().startswith("File")]
            key = (target.name, f"{lines[-1][:120]} {places[-1] if places else ''}")
            if not faults[key]:
                arguments.keep.mkdir(parents=True, exist_ok=True)
                (arguments.keep / f"{len(faults)}-{target.name.replace(' ', '-')}").write_bytes(
                    data
                )
            faults[key] += 1
    print(f"{arguments.inputs} inputs, {time.monotonic() - started_s:.0f} s, seed {arguments.seed}")
    print(f"{'kind':<22}{'read':>7}{'failed':>8}{'refused':>9}{'longest':>10}{'memory':>9}")
    for target in targets:
        counts = [statuses[target.name, s] for s in (0, 1, 2)]
        print(
            f"{target.name:<22}{counts[0]:>7}{counts[1]:>8}{counts[2]:>9}"
            f"{longest[target.name]:>8.1f} s{largest[target.name] / 1e6:>6.0f} MB"
        )
    for (name, what), count in faults.most_common():
        print(f"FAULT {count:>5} × {name}: {what}")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())

"""Parts 200 mm and 2° away, measured by LinuxCNC without a person, one after the other.

./omm exec python bench/blind_parts.py [COUNT [FIRST_SEED]]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))

from blind_part import measure_blind


def main() -> int:
    """Print one line a part; 1 where a target was seen less than twice."""
    count, first = (int(word) for word in (*sys.argv[1:], "10", "1")[:2])
    good = 0
    for seed in range(first, first + count):
        with tempfile.TemporaryDirectory() as folder:
            run = measure_blind(Path(folder) / "part", seed)
        good += run.least_views >= 2
        shift = " ".join(f"{v:7.1f}" for v in run.shift_mm)
        turn = " ".join(f"{v:5.2f}" for v in np.rad2deg(run.turn_rad))
        print(
            f"seed {seed:3d}  shift {shift} mm  turned {turn}°  images {run.images:3d} of"
            f" {run.planned} planned  least views {run.least_views}"
            f"  largest error {np.abs(run.errors_in_U).max():.2f} U",
            flush=True,
        )
    print(f"{good} of {count} parts: every target seen twice, no person needed")
    return 0 if good == count else 1


if __name__ == "__main__":
    sys.exit(main())

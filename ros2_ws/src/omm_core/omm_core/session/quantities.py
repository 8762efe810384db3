"""The seven unknowns as people read them: names, symbols, units, and the keys of the files.

The one place for it: text, pictures, tables, pages and messages take the names from here.
"""

from typing import NamedTuple


class Quantity(NamedTuple):
    """One unknown of θ (rad or mm) and how it is shown (mm/m or mm)."""

    name: str
    symbol: str
    unit: str
    key: str

    @property
    def scale(self) -> float:
        """Return what a value in rad or mm is multiplied by to be shown in ``unit``."""
        return 1000.0 if self.unit == "mm/m" else 1.0


# The order of θ (eq. 23).
THETA = (
    Quantity("alpha", "α", "mm/m", "alpha_rad"),
    Quantity("beta", "β", "mm/m", "beta_rad"),
    Quantity("gamma", "γ", "mm/m", "gamma_rad"),
    Quantity("x", "x", "mm", "x_mm"),
    Quantity("y", "y", "mm", "y_mm"),
    Quantity("z", "z", "mm", "z_mm"),
    Quantity("gamma_s", "γ_s", "mm/m", "gamma_s_rad"),
)

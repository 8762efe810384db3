"""The table of a live estimate."""

import math

from omm_interfaces.msg import PartEstimate
from rich.table import Table

from omm_core.session.quantities import THETA

_MILLI = 1000.0  # from m to mm, and from rad to mm/m


def estimate_table(estimate: PartEstimate) -> Table:
    """Return a live estimate's parameters with U, which 95.45 % of errors do not exceed."""
    table = Table(
        title=f"{estimate.part}, {estimate.model}, in the machine's own coordinates",
        title_justify="left",
    )
    table.add_column("parameter")
    table.add_column("unit")
    table.add_column("value", justify="right")
    table.add_column("U (95 %)", justify="right")
    for i, quantity in enumerate(THETA):
        uncertainty = estimate.expanded_uncertainty[i] if estimate.determined else math.nan
        value = estimate.theta[i]
        table.add_row(
            quantity.symbol,
            quantity.unit,
            f"{value * _MILLI:.4f}",
            f"{uncertainty * _MILLI:.4f}",
        )
    return table

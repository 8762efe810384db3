"""The table of a live estimate."""

import math

from omm_interfaces.msg import PartEstimate
from rich.table import Table

from omm_core.session.quantities import THETA

COVERAGE = 2.0
_MILLI = 1000.0  # from m to mm, and from rad to mm/m


def estimate_table(estimate: PartEstimate) -> Table:
    """The parameters of a live estimate with their expanded uncertainties."""
    table = Table(title=f"{estimate.part}, {estimate.model}", title_justify="left")
    table.add_column("parameter")
    table.add_column("unit")
    table.add_column("value", justify="right")
    table.add_column("U (k=2)", justify="right")
    for i, quantity in enumerate(THETA):
        sigma = math.sqrt(max(0.0, estimate.covariance[8 * i])) if estimate.determined else math.nan
        value = estimate.theta[i]
        table.add_row(
            quantity.symbol,
            quantity.unit,
            f"{value * _MILLI:.4f}",
            f"{COVERAGE * sigma * _MILLI:.4f}",
        )
    return table

"""Target coordinates from photographs taken by hand: start, free network, blunders, scale."""

from omm_core.survey.network import Network
from omm_core.survey.sighting import Bar, Sighting
from omm_core.survey.solving import solve_network

__all__ = ["Bar", "Network", "Sighting", "solve_network"]

"""Target coordinates from photographs taken by hand: start, free network, blunders, scale."""

from omm_core.survey.network import Bar, Network, Sighting, solve_network

__all__ = ["Bar", "Network", "Sighting", "solve_network"]

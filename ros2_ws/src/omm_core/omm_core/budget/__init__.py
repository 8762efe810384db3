"""How good a coordinate is: contributors, first order and Monte Carlo, capability, campaigns.

The formulas and where they stand: docs/budget.md.
"""

"""The operator's view of a measurement: progress, result, correction."""

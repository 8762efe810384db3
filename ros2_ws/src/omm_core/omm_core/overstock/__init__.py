"""The ideal part inside the raw one: placements with positive and even overstock."""

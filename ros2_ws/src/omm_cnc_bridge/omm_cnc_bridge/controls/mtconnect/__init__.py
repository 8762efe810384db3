"""Controls that are heard through an MTConnect agent."""

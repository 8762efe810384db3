"""What every omm node shares: parameters, conversions, quality of service, transport, main."""

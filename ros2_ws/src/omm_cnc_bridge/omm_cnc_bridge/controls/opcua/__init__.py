"""Controls that speak OPC UA."""

"""What ./omm does before it runs a command. Needs nothing but the standard library."""

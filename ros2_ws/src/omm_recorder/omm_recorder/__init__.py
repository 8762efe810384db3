"""Recordings of omm: write, read, replay (MCAP)."""

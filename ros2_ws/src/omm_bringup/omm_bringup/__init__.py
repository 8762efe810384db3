"""Starts omm: launch files, configuration, the command line."""

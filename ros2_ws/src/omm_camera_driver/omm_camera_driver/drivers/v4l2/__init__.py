"""Cameras of Video4Linux."""

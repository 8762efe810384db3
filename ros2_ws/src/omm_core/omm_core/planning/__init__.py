"""Where to take images for a wanted uncertainty, before any was taken (docs/planning.md)."""

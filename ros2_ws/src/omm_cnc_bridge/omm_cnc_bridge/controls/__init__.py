"""One folder a kind of control, behind the small protocol of `control`."""

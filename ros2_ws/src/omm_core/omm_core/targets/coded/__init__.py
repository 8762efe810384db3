"""Ring-coded targets: families, search, reading, judgement, centring, printing."""

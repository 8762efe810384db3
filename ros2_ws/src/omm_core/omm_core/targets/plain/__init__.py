"""Plain round targets: found without a number, centred like the dots of coded ones."""

from omm_core.targets.plain.finding import PlainDot, PlainOptions, find_plain_dots

__all__ = ["PlainDot", "PlainOptions", "find_plain_dots"]

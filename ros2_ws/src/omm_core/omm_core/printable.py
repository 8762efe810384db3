"""Words from outside as they may be shown: nothing in them steers the terminal."""

import unicodedata

_KEPT = "\n\t"
_STEERING = ("Cc", "Cf", "Zl", "Zp")
"""Control characters, and those that turn the direction of writing or end a line unseen."""


def printable(text: str) -> str:
    r"""Return a text with everything that would control a terminal escaped, as in \x1b.

    Bytes of names that are not UTF-8 (surrogates) stay as they are.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        c if c in _KEPT or unicodedata.category(c) not in _STEERING else _escaped(c) for c in text
    )


def _escaped(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"

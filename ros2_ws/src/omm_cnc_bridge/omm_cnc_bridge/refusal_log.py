"""When refusals are worth a line in the log."""

from __future__ import annotations

PATIENCE_S = 2.0
REPEAT_S = 30.0


class RefusalLog:
    """Tells of refusals that went on for PATIENCE_S without one pose, and again every REPEAT_S.

    A clock that is not certain yet, or one late sample, is over before that.
    """

    def __init__(self) -> None:
        self._since_s: float | None = None
        self._due_s = 0.0

    def hear(self, refused: str, now_s: float) -> str:
        """Return the line to log, or nothing.

        Parameters
        ----------
        refused : str
            Why a sample became no pose; empty where it became one.
        now_s : float
            Of a clock that only goes forward.
        """
        if not refused:
            self._since_s = None
            return ""
        if self._since_s is None:
            self._since_s, self._due_s = now_s, now_s + PATIENCE_S
        if now_s < self._due_s:
            return ""
        self._due_s = now_s + REPEAT_S
        return f"no pose for {now_s - self._since_s:.0f} s, every sample is refused: {refused}"

"""What the camera node says of its health."""

from omm_camera_driver.worker_status import Status, WorkerState
from omm_core.words import Words, keyed, verbatim
from omm_ros.diagnostics import ERROR, OK, WARN, Health

_STATES = {
    WorkerState.INACTIVE: keyed("said.camera_inactive", "inactive"),
    WorkerState.ABSENT: keyed("said.camera_absent", "absent"),
    WorkerState.OPENING: keyed("said.camera_opening", "opening"),
    WorkerState.STREAMING: keyed("said.camera_streaming", "streaming"),
    WorkerState.LOST: keyed("said.camera_lost", "lost"),
}


def connection_health(status: Status, failure: str = "") -> Health:
    """Return how the connection to the camera is, with its figures.

    Parameters
    ----------
    status : Status
        Of the worker.
    failure : str
        Why the simulated machine is no longer heard; empty where it is, or where none is needed.
    """
    if failure:
        return Health(level=ERROR, message=failure, values=_values(status))
    return Health(level=_level(status), message=_summary(status), values=_values(status))


def _level(status: Status) -> bytes:
    if status.state is WorkerState.INACTIVE:
        return WARN
    if status.state is not WorkerState.STREAMING:
        return ERROR
    return WARN if status.problem else OK


def _summary(status: Status) -> Words:
    return _words_of(status.problem) if status.problem else _STATES[status.state]


def _words_of(problem: str) -> Words:
    """Return a driver's problem: with its key, or as its library said it."""
    return problem if isinstance(problem, Words) else verbatim(problem)


def _values(status: Status) -> dict[str, object]:
    values: dict[str, object] = {
        "state": status.state.value,
        "camera": status.camera or "",
        "rate_hz": round(status.rate_hz, 2),
        "stamp_uncertainty_us": round(status.stamp_uncertainty_ns / 1000, 1),
        "published": status.published,
        "incomplete": status.incomplete,
        "missing": status.missing,
        "stale": status.stale,
        "unanswered_triggers": status.unanswered_triggers,
        "connections": status.connections,
        "clock_steps": status.clock_steps,
    }
    granted = status.camera.granted if status.camera is not None else {}
    return {**values, **granted, **status.health}

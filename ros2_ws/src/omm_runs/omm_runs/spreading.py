"""Work spread over all cores, or over the workers of a Dask scheduler; results in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

from omm_core.errors import DeviceError, InputError

Task = TypeVar("Task")
Result = TypeVar("Result")


def spread(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Result]:
    """Return what a function makes of each task.

    Parameters
    ----------
    function : callable
        Of a module that the workers can import, too.
    jobs : int, optional
        Processes side by side; default: one for each core. One: in this process.
    scheduler : str, optional
        Address of a Dask scheduler (``tcp://host:8786``) whose workers do the work instead.
    progress : callable, optional
        Is told how many of how many are done.

    Raises
    ------
    InputError
        Where Dask is not installed.
    DeviceError
        Where the scheduler does not answer.
    """
    tell = progress or (lambda done, total: None)
    if scheduler is not None:
        return _by_dask(function, tasks, scheduler, tell)
    jobs = max(1, min(jobs or len(os.sched_getaffinity(0)), len(tasks)))
    if jobs == 1:
        found = []
        for task in tasks:
            found.append(function(task))
            tell(len(found), len(tasks))
        return found
    # Fresh processes: those forked from a process with threads may hang.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(function, task) for task in tasks]
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                tell(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]


def _by_dask(
    function: Callable[[Any], Result],
    tasks: Sequence[Any],
    address: str,
    tell: Callable[[int, int], None],
) -> list[Result]:
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError:
        raise InputError(
            "--scheduler needs Dask, which is not installed here: install the package distributed."
        ) from None
    try:
        client = Client(address, timeout=5)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(f"The Dask scheduler {address} does not answer: {error}.") from None
    with client:
        if not client.scheduler_info().get("workers"):
            raise DeviceError(f"The Dask scheduler {address} has no workers: start some there.")
        futures = client.map(function, tasks, pure=False)
        for done, future in enumerate(completed(futures), start=1):
            if future.status == "error":
                client.cancel(futures)
                future.result()  # raises what the worker raised
            tell(done, len(tasks))
        return list(client.gather(futures))

"""What commands have other nodes do, by their services."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omm_interfaces.srv import WorkOffset
from rclpy.client import Client
from rclpy.node import Node
from std_srvs.srv import Trigger

from omm_core.words import Words, keyed, verbatim, with_beside
from omm_operator.conversions import offset_fact, offset_request
from omm_operator.operating import Refused
from omm_operator.screen.facts import OffsetFact

_BRIDGE = keyed("said.the_bridge", "the CNC bridge")
_ESTIMATOR = keyed("said.the_estimator", "the estimator")
_NO_WORD = keyed("said.report_no_word", "The report failed without saying why.")
_ANSWER_S = 20.0
_REPORT_S = 300.0


class RosActions:
    """Calls the services of bridge and estimator; the recording's place comes from the recorder.

    Parameters
    ----------
    node : the node that asks
    recording : callable
        Path of the recording that is being made; empty where there is none.
    """

    def __init__(self, node: Node, recording: Callable[[], str]) -> None:
        self._start = node.create_client(Trigger, "cnc_bridge/start_program")
        self._offset = node.create_client(WorkOffset, "cnc_bridge/work_offset")
        self._clamping = node.create_client(Trigger, "estimator/new_clamping")
        self._recording = recording

    async def start_program(self) -> None:
        """Let the control start its measuring program."""
        await _ask(self._start, Trigger.Request(), _BRIDGE)

    async def new_clamping(self) -> None:
        """Let the estimator forget all images."""
        await _ask(self._clamping, Trigger.Request(), _ESTIMATOR)

    async def work_offset(self, name: str, wanted: OffsetFact | None) -> OffsetFact:
        """Return a work offset as the control has it, after writing it where one is given."""
        response = await _ask(self._offset, offset_request(name, wanted), _BRIDGE)
        return offset_fact(name, response)

    async def report(self, language: str) -> bytes:
        """Return the measurement so far as PDF, made by a process of its own."""
        recording = self._recording()
        if not recording:
            raise Refused(keyed("said.no_recording", "The recorder has not said where it records."))
        with TemporaryDirectory(prefix="omm-report-") as folder:
            out = Path(folder) / "report.pdf"
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "omm_operator.reporting", recording, str(out), language,
                stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
            )  # fmt: skip
            try:
                _, told = await asyncio.wait_for(process.communicate(), _REPORT_S)
            except asyncio.TimeoutError as error:
                process.kill()
                raise Refused(
                    keyed(
                        "said.report_late",
                        "The report was not ready after {s} s.",
                        s=f"{_REPORT_S:g}",
                    )
                ) from error
            if process.returncode != 0:
                words = told.decode(errors="replace").strip().splitlines()
                raise Refused(verbatim(words[-1]) if words else _NO_WORD)
            return out.read_bytes()


async def _ask(client: Client, request: Any, who: Words) -> Any:
    """Return a service's answer.

    Raises
    ------
    Refused
        Where nobody answers, or the answer is no.
    """
    if not client.service_is_ready():
        raise Refused(keyed("said.nobody_answers", "No answer from {who}.", who=who))
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[Any] = loop.create_future()

    def done(future: Any) -> None:
        loop.call_soon_threadsafe(_settle, answer, future)

    asked = client.call_async(request)
    asked.add_done_callback(done)
    try:
        response = await asyncio.wait_for(answer, _ANSWER_S)
    except asyncio.TimeoutError as error:
        client.remove_pending_request(asked)
        raise Refused(
            keyed(
                "said.no_answer_within",
                "No answer from {who} within {s} s.",
                who=who,
                s=f"{_ANSWER_S:g}",
            )
        ) from error
    if not response.success:
        said = with_beside(response.message, getattr(response, "said", ""))
        refused = keyed("said.no_reason", "{who} refused and did not say why.", who=who)
        raise Refused(said or refused)
    return response


def _settle(answer: asyncio.Future[Any], future: Any) -> None:
    if answer.done():
        return
    error = future.exception()
    if error is not None:
        answer.set_exception(Refused(str(error)))
    else:
        answer.set_result(future.result())

"""The operator's part in a measurement: press cycle start, watch, read the result."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from omm_interfaces.msg import PartEstimate
from rclpy.client import Client
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from std_srvs.srv import Trigger

from omm_core.errors import InputError, MeasurementError
from omm_operator.estimate_table import estimate_table
from omm_operator.view import OperatorView
from omm_ros import node_help, topics, transport
from omm_ros.diagnostics import line_name
from omm_ros.environment import check_environment
from omm_ros.interrupt import told_to_end
from omm_ros.node_main import end_with_parent

_READY_S = 30.0
_SILENT_S = 60.0
_BY_HAND_S = 1800.0  # for a person to go to the control and start the program
_LAST_IMAGE_S = 15.0  # after the program's end, for an image that was asked for
_POLL_S = 0.05
_LISTENERS = {"recorder", "estimator"}


@dataclass(frozen=True, kw_only=True)
class NoParameters:
    """It has none: what is measured, the other nodes know."""


def measure(
    node: Node, console: Console, check_alive: Callable[[], None], *, by_hand: bool = False
) -> PartEstimate:
    """Start the program once every station is there, show the progress, return the last estimate.

    Parameters
    ----------
    check_alive : raises MeasurementError when a node has died
    by_hand : the program is started at the control, by a person who is told to

    Raises
    ------
    MeasurementError
        A station does not come, or the images stop coming.
    """
    with OperatorView(node, console) as view:
        _start_program(node, check_alive, by_hand)
        console.print(
            "omm: camera, CNC bridge, estimator and recorder run; "
            + ("start the measuring program at the control" if by_hand else "program started")
        )
        heard, since = -1, time.monotonic()
        # Before a person has started it, the last program's end is no end of this one.
        while not view.progress.settled or (by_hand and not view.progress.images_judged):
            rclpy.spin_once(node, timeout_sec=_POLL_S)
            check_alive()
            view.show()
            if view.progress.images_judged != heard:
                heard, since = view.progress.images_judged, time.monotonic()
            silent_s = time.monotonic() - since
            ended = view.progress.came_to_an_end and view.progress.images_judged > 0
            if (ended if by_hand else view.progress.came_to_an_end) and silent_s > _LAST_IMAGE_S:
                console.print(
                    f"omm: {view.progress.images_missing} of the images asked for never came"
                )
                break
            limit_s = _BY_HAND_S if by_hand and not view.progress.images_judged else _SILENT_S
            if silent_s > limit_s:
                raise MeasurementError(f"No image came for {limit_s:.0f} s.")
    assert view.progress.estimate is not None
    return view.progress.estimate


def measure_alone(
    console: Console,
    check_alive: Callable[[], None],
    arguments: list[str] | None = None,
    *,
    by_hand: bool = False,
    for_good: bool = False,
) -> PartEstimate:
    """Run `measure` in a process without other nodes.

    It raises KeyboardInterrupt at Ctrl-C. With `for_good` the process ends afterwards: no further
    Ctrl-C interrupts that.
    """
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with told_to_end(for_good=for_good) as ended:

            def check() -> None:
                if ended.is_set():
                    raise KeyboardInterrupt
                check_alive()

            return measure(Node("operator"), console, check, by_hand=by_hand)
    finally:
        rclpy.try_shutdown()


def _start_program(node: Node, check_alive: Callable[[], None], by_hand: bool) -> None:
    start = node.create_client(Trigger, "cnc_bridge/start_program")
    camera = _Health(node)
    deadline = time.monotonic() + _READY_S
    while missing := _not_ready(node, start, camera):
        rclpy.spin_once(node, timeout_sec=_POLL_S)
        check_alive()
        if camera.preparing_s is not None:  # for as long as somebody says that it goes on
            deadline = max(deadline, camera.preparing_s + _READY_S)
        if time.monotonic() > deadline:
            said = f" It said: {camera.problem}" if camera.problem and "camera" in missing else ""
            raise MeasurementError(f"Waited {_READY_S:.0f} s for {missing}.{said}")
    if by_hand:
        return
    answer = start.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, answer, timeout_sec=_READY_S)
    if not answer.done() or not answer.result().success:
        why = answer.result().message if answer.done() else "no answer"
        raise MeasurementError(f"The control did not start its program: {why}.")


class _Health:
    """What the camera says of its connection, and whether somebody is still preparing."""

    def __init__(self, node: Node) -> None:
        self.is_connected = False
        self.problem = ""
        self.preparing_s: float | None = None
        self._line = line_name(f"{node.get_namespace().rstrip('/')}/camera", "connection")
        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._line:
                told = {value.key: value.value for value in status.values}
                fine = status.level == DiagnosticStatus.OK
                # After an image that did not come it warns, and is there all the same.
                self.is_connected = fine or told.get("state") == "streaming"
                self.problem = "" if self.is_connected else status.message
            if status.message.startswith("preparing"):
                self.preparing_s = time.monotonic()


def _not_ready(node: Node, start: Client, camera: _Health) -> str:
    """Return what is still missing before the program may start; empty when nothing is."""
    if not start.service_is_ready():
        return "the CNC bridge"
    if not node.get_publishers_info_by_topic(topics.IMAGE) or not camera.is_connected:
        return "the camera"
    listeners = {i.node_name for i in node.get_subscriptions_info_by_topic(topics.IMAGE)}
    return " and ".join(sorted(_LISTENERS - listeners))


def main(args: list[str] | None = None) -> int:
    """Run as a node beside others that somebody else has started (a launch file)."""
    if node_help.asked(args):
        print(node_help.help_text(measure.__doc__ or "", NoParameters), end="")
        return 0
    try:
        check_environment()
    except InputError as error:
        print(f"omm: {error}", file=sys.stderr)
        return 2
    end_with_parent()
    transport.prepare(args)
    console = Console()
    try:
        estimate = measure_alone(console, lambda: None, args, for_good=True)
        console.print(estimate_table(estimate))
    except MeasurementError as error:
        console.print(f"omm: {error}", style="red")
        return 1
    except KeyboardInterrupt:
        return 130
    return 0 if estimate.determined else 1

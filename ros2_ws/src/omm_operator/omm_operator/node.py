"""The node ``operator``: what is heard of the cell, as a page for whoever stands at the machine.

ROS spins in the main thread and turns messages into facts; everything else happens in the server's
thread (`operating.Operation`).
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from omm_interfaces.msg import OperatorCommand, PartEstimate, SpindleState, TargetObservations
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.task import Future
from sensor_msgs.msg import Image

from omm_core.errors import InputError, OmmError
from omm_core.files.machine import load_machine
from omm_core.files.outside import read_bytes
from omm_core.files.part import load_part
from omm_core.words import of_error
from omm_operator import conversions
from omm_operator.operating import Operation
from omm_operator.parameters import Parameters
from omm_operator.ros_actions import RosActions
from omm_operator.screen.commands import Command
from omm_operator.screen.desk import Answer, Asker
from omm_operator.screen.handing import HandingOptions
from omm_operator.screen.screen import Screen
from omm_operator.web.access import Hosts, Listening, Sessions
from omm_operator.web.application import application
from omm_operator.web.serving import ServerThread, listen, tls_context
from omm_ros import qos, topics
from omm_ros.adaptive_subscription import AdaptiveSubscription
from omm_ros.conversions import time_from_ns
from omm_ros.node_main import run_node
from omm_ros.parameters import declare
from omm_ros.published import CountingNode

_PICTURE_PERIOD_S = 0.2
_LOOK_PERIOD_S = 0.5
_ASK_PERIOD_S = 5.0
_STATIONS = {"estimator": topics.ESTIMATE, "camera": topics.IMAGE, "bridge": topics.SPINDLE_STATE}
ESTIMATOR, BRIDGE = "estimator", "cnc_bridge"
_ASKED = {ESTIMATOR: ("part_file",), BRIDGE: ("allow_commands", "control", "linuxcnc_cell")}


class OperatorNode(CountingNode):
    """Listens, and serves the page.

    Raises
    ------
    InputError
        Where the port is taken, or a file cannot be used.
    """

    def __init__(self) -> None:
        super().__init__("operator")
        self._p = p = declare(self, Parameters)
        context = tls_context(p.tls_certificate_file, p.tls_key_file)
        screen = self._make_screen()
        sockets, port = listen(p.address, p.port)
        self._where = Listening(
            address=p.address, port=port, hosts=p.hosts, secure=context is not None
        )
        self._recording, self._pictures, self._picture_due_s = "", 0, 0.0
        self._asked_for: tuple[str, int] | None = None
        self._ask_due_s = 0.0
        self._part_file: tuple[str, bytes] | None = None
        self._commands = self.create_publisher(OperatorCommand, "omm/operator_commands", qos.STATE)
        actions = RosActions(self, lambda: self._recording)
        self._operation = Operation(screen, actions, self._record)
        self._sessions = Sessions(time.monotonic)
        self._server = ServerThread(sockets, context, self._make_application)
        self._listen_to_all()
        self._server.start()
        if p.part_file:
            self._take_part_file(p.part_file)
        self._introduce()

    def destroy_node(self) -> None:
        """End the server, then the node."""
        self._server.close()
        super().destroy_node()

    # --- making --------------------------------------------------------------------------------

    def _make_screen(self) -> Screen:
        p = self._p
        options = HandingOptions(
            control=p.control, offset=p.offset, remaining_mm=p.remaining_mm, fresh_s=p.fresh_s
        )
        options.check()
        screen = Screen(
            options=options, wall_ns=time.time_ns, clock_s=time.monotonic, stops=p.stops
        )
        if p.machine_file:
            screen.kept.up = load_machine(Path(p.machine_file)).up
        return screen

    def _make_application(self) -> object:
        made, pages = application(
            self._operation,
            self._operation.desk,
            Hosts(self._where.names(), self._where.port, secure=self._where.secure),
            self._sessions,
            tell_tokens=lambda asker: self._tell_tokens(),
            language=self._p.language,
        )
        self._operation.show_with(pages.show)
        return made

    def _listen_to_all(self) -> None:
        self.create_subscription(PartEstimate, topics.ESTIMATE, self._on_estimate, qos.LATCHED)
        self.create_subscription(SpindleState, topics.SPINDLE_STATE, self._on_state, qos.STATE)
        self.create_subscription(
            TargetObservations, topics.OBSERVATIONS, self._on_found, qos.OBSERVATIONS
        )
        self._images = AdaptiveSubscription(self, Image, topics.IMAGE, self._on_image, qos.IMAGE)
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 50)
        self._askers = {
            node: self.create_client(GetParameters, f"{node}/get_parameters") for node in _ASKED
        }
        self.create_timer(_LOOK_PERIOD_S, self._look)

    # --- what is heard -------------------------------------------------------------------------

    def _take(self, take: object, fact: object) -> None:
        self._server.call(self._operation.take, take, fact)

    def _on_estimate(self, message: PartEstimate) -> None:
        if (message.part, message.clamping) != self._asked_for:
            self._ask_due_s = 0.0
            self._asked_for = (message.part, message.clamping)
        self._take(self._operation.screen.take_estimate, conversions.estimate_fact(message))

    def _on_state(self, message: SpindleState) -> None:
        self._take(self._operation.screen.take_control, conversions.control_fact(message))

    def _on_found(self, message: TargetObservations) -> None:
        self._take(self._operation.screen.take_found, conversions.found_fact(message))

    def _on_image(self, message: Image) -> None:
        if time.monotonic() < self._picture_due_s:
            return
        self._picture_due_s = time.monotonic() + _PICTURE_PERIOD_S
        self._pictures += 1
        try:
            fact = conversions.picture_fact(message, self._pictures)
        except InputError as error:
            self.get_logger().warning(f"image: {error}", throttle_duration_sec=5.0)
            return
        self._take(self._operation.screen.take_picture, fact)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        ours = f"{self.get_namespace().strip('/')}/".lstrip("/")
        for status in message.status:
            # Another machine's diagnostics stand on the same topic, with its namespace.
            name = status.name.removeprefix(ours)
            if not status.name.startswith(ours) or "/" in name.partition(":")[0]:
                continue
            status.name = name
            fact = conversions.health_fact(status)
            if fact.node == "recorder" and "file" in fact.values:
                self._recording = fact.values["file"]
            self._take(self._operation.screen.take_health, fact)

    # --- what is asked for ---------------------------------------------------------------------

    def _look(self) -> None:
        """See who has left, and ask nodes for the parameters that decide what the page allows."""
        if self._server.failure is not None:  # nobody would see that nothing is served any more
            raise OmmError(f"The page's thread has ended: {self._server.failure!r}.")
        for station, topic in _STATIONS.items():
            if self.count_publishers(topic) == 0:
                self._server.call(self._operation.screen.lose, station)
        if time.monotonic() >= self._ask_due_s:
            self._ask_due_s = time.monotonic() + _ASK_PERIOD_S
            for node, client in self._askers.items():
                if client.service_is_ready():
                    request = GetParameters.Request(names=list(_ASKED[node]))
                    client.call_async(request).add_done_callback(partial(self._on_answer, node))

    def _on_answer(self, node: str, future: Future) -> None:
        response = future.result()
        if response is None or len(response.values) != len(_ASKED[node]):
            return
        values = [_value(value) for value in response.values]
        if node == ESTIMATOR:
            if not self._p.part_file and isinstance(values[0], str) and values[0]:
                self._take_part_file(values[0])
            return
        allowed, control, cell = values
        self._take(
            self._operation.screen.take_allowed,
            allowed is True or control == "simulated" or bool(cell),
        )

    def _take_part_file(self, path: str) -> None:
        """Take a part file that a parameter names, here or at the estimator: never a page."""
        try:
            content = read_bytes(path, "part file")
            if (path, content) == self._part_file:
                return
            self._part_file = (path, content)
            self._take(self._operation.screen.take_part_or_why, load_part(path))
        except InputError as error:
            self._take(self._operation.screen.take_part_or_why, of_error(error))

    # --- what is told --------------------------------------------------------------------------

    def _record(self, asker: Asker, command: Command, answer: Answer | None) -> None:
        """Publish a command, for the recorder; called in the server's thread."""
        outcome = OperatorCommand.ASKED
        if answer is not None:
            outcome = OperatorCommand.ACCEPTED if answer.accepted else OperatorCommand.REFUSED
        more = {} if answer is None else dict(answer.more)
        self._commands.publish(
            OperatorCommand(
                stamp=time_from_ns(time.time_ns()),
                who=asker.who,
                role=asker.role,
                command=command.name,
                arguments=json.dumps({**command.arguments, **more}, sort_keys=True),
                key=command.key,
                outcome=outcome,
                reason="" if answer is None else answer.said.in_language("en"),
            )
        )

    def _introduce(self) -> None:
        where = self._where
        scheme = "https" if where.secure else "http"
        name = where.names()[0] if where.names() and not where.alone else "127.0.0.1"
        self.get_logger().info(f"The page is at {scheme}://{name}:{where.port}/")
        if not where.alone:
            self._tell_tokens()
            if not where.secure:
                self.get_logger().warning(
                    "Other computers reach this page without TLS: whoever listens on the network "
                    "can take over a session. Give tls_certificate_file and tls_key_file."
                )

    def _tell_tokens(self) -> None:
        if not self._where.alone:
            for role, token in self._sessions.tokens().items():
                # Not through ROS's log: that is on a topic, and in every recording.
                print(
                    f"One-time token for another computer, {role}: {token}",
                    file=sys.stderr,
                    flush=True,
                )


def _value(value: ParameterValue) -> object:
    if value.type == ParameterType.PARAMETER_BOOL:
        return value.bool_value
    return value.string_value if value.type == ParameterType.PARAMETER_STRING else None


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    # Less urgent than what measures: a page that many look at must not slow the estimator (5).
    return run_node(OperatorNode, args, parameters=Parameters, threads=1, niceness=10)

"""What the recorder records, and with which quality of service."""

from collections.abc import Sequence
from dataclasses import dataclass

from omm_recording.rosbag2_format import TopicQos

_IMAGE = TopicQos(depth=20)
_STREAM = TopicQos(depth=1000)
_STATE = TopicQos(depth=100)
_LATCHED = TopicQos(depth=100, latched=True)
_LOG = TopicQos(depth=1000, latched=True)  # what was said before the recorder came, too


@dataclass(frozen=True, kw_only=True)
class KnownTopic:
    """A topic that is listened to from the start, so that its first message is not missed."""

    name: str
    type_name: str
    qos: TopicQos
    shared: bool = False
    """Whether several nodes publish it, so that their numbers cannot be told apart."""

    @property
    def heard_as(self) -> str:
        """The name to subscribe to: that of the recorder's namespace, or what is everybody's."""
        return self.name if self.shared else self.name.lstrip("/")


KNOWN = (
    KnownTopic(name="/camera/image_raw", type_name="sensor_msgs/msg/Image", qos=_IMAGE),
    KnownTopic(name="/camera/camera_info", type_name="sensor_msgs/msg/CameraInfo", qos=_STATE),
    KnownTopic(name="/cnc/spindle_pose", type_name="geometry_msgs/msg/PoseStamped", qos=_STREAM),
    KnownTopic(name="/cnc/state", type_name="omm_interfaces/msg/SpindleState", qos=_STREAM),
    KnownTopic(
        name="/omm/observations", type_name="omm_interfaces/msg/TargetObservations", qos=_STATE
    ),
    KnownTopic(name="/omm/estimate", type_name="omm_interfaces/msg/PartEstimate", qos=_LATCHED),
    KnownTopic(
        name="/omm/part_pose",
        type_name="geometry_msgs/msg/PoseWithCovarianceStamped",
        qos=_LATCHED,
    ),
    KnownTopic(
        name="/omm/operator_commands", type_name="omm_interfaces/msg/OperatorCommand", qos=_STATE
    ),
    KnownTopic(name="/tf", type_name="tf2_msgs/msg/TFMessage", qos=_STREAM, shared=True),
    KnownTopic(name="/tf_static", type_name="tf2_msgs/msg/TFMessage", qos=_LATCHED, shared=True),
    KnownTopic(
        name="/diagnostics",
        type_name="diagnostic_msgs/msg/DiagnosticArray",
        qos=_STATE,
        shared=True,
    ),
    KnownTopic(name="/rosout", type_name="rcl_interfaces/msg/Log", qos=_LOG, shared=True),
    KnownTopic(
        name="/parameter_events",
        type_name="rcl_interfaces/msg/ParameterEvent",
        qos=_STREAM,
        shared=True,
    ),
)


def adapted(wanted: TopicQos, offered: Sequence[TopicQos]) -> TopicQos:
    """Return the strictest quality of service that matches every publisher of a topic.

    A subscription that asks for more than a publisher offers gets nothing of it.
    """
    return TopicQos(
        reliable=wanted.reliable and all(qos.reliable for qos in offered),
        latched=wanted.latched and all(qos.latched for qos in offered),
        depth=wanted.depth,
    )

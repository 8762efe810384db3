"""Names of omm's topics. They are relative: a namespace gives every machine its own.

`/tf`, `/tf_static` and `/diagnostics` are everybody's, as usual in ROS; there a machine is told
apart by its frames (parameter `frame_prefix`) and by its nodes' full names.
"""

IMAGE = "camera/image_raw"
CAMERA_INFO = "camera/camera_info"
SET_CAMERA_INFO = "camera/set_camera_info"
SPINDLE_POSE = "cnc/spindle_pose"
SPINDLE_STATE = "cnc/state"
OBSERVATIONS = "omm/observations"
ESTIMATE = "omm/estimate"
PART_POSE = "omm/part_pose"
TRUE_SPINDLE_POSE = "simulation/true_spindle_pose"
TRUE_PART_POSE = "simulation/true_part_pose"
MARKERS = "omm/markers"
CAMERA_VIEW = "omm/camera_view"
ROBOT_DESCRIPTION = "robot_description"
JOINT_STATES = "joint_states"
OVERLAY = "omm/overlay/compressed"
OPERATOR_COMMANDS = "omm/operator_commands"

TF = "/tf"
TF_STATIC = "/tf_static"
DIAGNOSTICS = "/diagnostics"


def without_namespace(name: str, namespace: str) -> str:
    """Drop a node's own namespace from a full name: what a recording calls the topic.

    >>> without_namespace("/mill1/camera/image_raw", "/mill1")
    '/camera/image_raw'
    """
    inside = namespace.rstrip("/") + "/"
    return "/" + name[len(inside) :] if name.startswith(inside) else name

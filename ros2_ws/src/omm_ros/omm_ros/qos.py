"""Quality of service of omm's topics, the same on both ends."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


IMAGE = _reliable(5)  # 25 MB of images wait for a slow listener; more would only be late
POSE = _reliable(5000)  # many seconds of poses: one that is lost makes an image useless
STATE = _reliable(50)
OBSERVATIONS = _reliable(50)
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)

"""What rosbag2 writes about a recording, so that `ros2 bag` knows it as its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from omm_core.errors import InputError
from omm_core.files.strict_yaml import parse_yaml

VERSION = 9  # Jazzy's: the first with quality of service in words
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True, kw_only=True)
class TopicQos:
    """What of a publisher's quality of service matters for playing its messages again."""

    reliable: bool = True
    latched: bool = False
    depth: int = 10


@dataclass(frozen=True, kw_only=True)
class TopicCount:
    """One topic of a recording."""

    name: str
    type_name: str
    type_hash: str
    qos: TopicQos
    messages: int


def qos_profiles(qos: TopicQos) -> list[dict[str, Any]]:
    """Return the list that rosbag2 keeps for each topic, with one entry."""
    return [
        {
            "history": "keep_last",
            "depth": qos.depth,
            "reliability": "reliable" if qos.reliable else "best_effort",
            "durability": "transient_local" if qos.latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def channel_metadata(qos: TopicQos, type_hash: str) -> dict[str, str]:
    """Return what rosbag2_storage_mcap writes into a channel."""
    return {
        "offered_qos_profiles": dumped(qos_profiles(qos)),
        "topic_type_hash": type_hash,
    }


def parsed_qos(text: str) -> TopicQos:
    """Read a channel's quality of service, in words or in rosbag2's older numbers."""
    try:
        profile = parse_yaml(text, "quality of service")[0]
        reliability, durability = str(profile["reliability"]), str(profile["durability"])
        depth = int(profile["depth"])
    except (InputError, KeyError, TypeError, IndexError, ValueError):
        return TopicQos()
    return TopicQos(
        reliable=reliability not in ("best_effort", "2"),
        latched=durability in ("transient_local", "1"),
        depth=depth if 0 < depth < 10_000 else 10,
    )


def bag_metadata(
    file_name: str, topics: Sequence[TopicCount], start_ns: int, duration_ns: int, distro: str
) -> dict[str, Any]:
    """Return the content of ``metadata.yaml`` under ``rosbag2_bagfile_information``."""
    total = sum(topic.messages for topic in topics)
    duration = {"nanoseconds": duration_ns}
    start = {"nanoseconds_since_epoch": start_ns}
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.messages,
            }
            for topic in topics
        ],
        # Chunks may be compressed; to rosbag2 that is the storage's own matter.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [
            {
                "path": file_name,
                "starting_time": dict(start),
                "duration": dict(duration),
                "message_count": total,
            }
        ],
        "custom_data": None,
        "ros_distro": distro,
    }


def dumped(value: Any) -> str:
    """Return YAML without anchors, in the order given."""
    return str(yaml.dump(value, Dumper=_Plain, sort_keys=False))


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:  # the C++ reader takes them, people do not
        return True

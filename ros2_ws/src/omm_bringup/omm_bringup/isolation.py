"""A ROS domain of one's own, on this machine only: runs neither hear nor disturb each other."""

import contextlib
import os
from collections.abc import Iterator

from domain_coordinator import domain_id


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a domain that no other omm run uses, and keep discovery on this machine.

    A domain that the user has set is respected.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_STATIC_PEERS", None)
    if "OMM_DOMAIN_ID" in os.environ:
        os.environ["ROS_DOMAIN_ID"] = os.environ["OMM_DOMAIN_ID"]
        yield int(os.environ["ROS_DOMAIN_ID"])
        return
    # Entered by hand: the library's generator would take an OSError of ours for a port in use.
    stack = contextlib.ExitStack()
    number = stack.enter_context(domain_id())
    os.environ["ROS_DOMAIN_ID"] = str(number)
    try:
        yield number
    finally:
        stack.close()

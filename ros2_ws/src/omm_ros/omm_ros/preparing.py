"""Long preparation inside a transition: shown with progress, and ended by Ctrl-C and SIGTERM."""

import threading
import time
from collections.abc import Callable

from rclpy.node import Node

from omm_ros.leaving import leave

_LOOK_S = 0.1
_TELL_S = 5.0


def while_preparing(
    node: Node, what: str, work: Callable[[], None], beat: Callable[[], None]
) -> None:
    """Do `work` on a separate thread, and report that it goes on.

    Kernels are compiled when the workspace is built. Where they are not (another user's cache,
    another compiler), the first start compiles them: half a minute on a quiet machine.

    Parameters
    ----------
    node : that waits for it
    what : is being done, for people
    work : what takes long
    beat : called about once a second while it goes on

    Raises
    ------
    KeyboardInterrupt
        The node was told to end; the work is left to end with the process.
    Exception
        Whatever `work` raised.
    """
    failed: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, name=what, daemon=True)
    begin_s = time.monotonic()
    told_s = beaten_s = begin_s
    thread.start()
    while thread.is_alive():
        thread.join(_LOOK_S)
        now_s = time.monotonic()
        if not node.context.ok():
            leave(thread)
            raise KeyboardInterrupt
        if now_s - beaten_s > 1.0:
            beaten_s = now_s
            beat()
        if now_s - told_s > _TELL_S:
            told_s = now_s
            node.get_logger().info(f"{what}, {now_s - begin_s:.0f} s so far (only once)")
    if failed:
        raise failed[0]

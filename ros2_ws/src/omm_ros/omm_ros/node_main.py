"""The `main` of every omm node: start, spin, end cleanly."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import InvalidHandle, NotInitializedException
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node

from omm_core.errors import InputError, OmmError
from omm_ros import node_help, transport
from omm_ros.environment import check_environment
from omm_ros.interrupt import Interrupts
from omm_ros.leaving import end_process

AUTOSTART = "autostart"
END_WITH_PARENT = "OMM_END_WITH_PARENT"
"""Environment variable: 1 has a node end, cleanly, when the process that started it is gone."""
_PR_SET_PDEATHSIG = 1
_AUTOSTART = ParameterDescriptor(
    description="Configure and activate by itself; false: wait for a lifecycle manager.",
    read_only=True,
)


def run_node(
    make: Callable[[], Node],
    arguments: list[str] | None = None,
    *,
    parameters: type,
    threads: int = 2,
    niceness: int = 0,
) -> int:
    """Run one node until it is told to end (Ctrl-C, SIGTERM, shutdown of the context).

    It ends after the callback that runs; a second Ctrl-C, a second later, interrupts that one, too.
    Once it is closing, no signal interrupts it.

    A lifecycle node configures and activates itself unless its parameter `autostart` is false,
    so that `ros2 run` works without a manager. A node that computes gives way to those that must
    be in time (camera, control) by its niceness.

    Parameters
    ----------
    make : makes the node
    arguments : command line without the program's name; default: the process's
    parameters : the dataclass of its parameters, which `--help` describes
    threads : callbacks that may run at the same time
    niceness : how much it gives way to others

    Returns
    -------
    0 after a clean end, 1 when the node failed, 2 when its parameters cannot be used.
    """
    status = _run(make, arguments, parameters=parameters, threads=threads, niceness=niceness)
    return end_process(status)


def _run(
    make: Callable[[], Node],
    arguments: list[str] | None,
    *,
    parameters: type,
    threads: int,
    niceness: int,
) -> int:
    if node_help.asked(arguments):
        print(node_help.help_text(make.__doc__ or "", parameters), end="")
        return 0
    try:
        check_environment()
    except InputError as error:
        return _failed(None, error, 2)
    end_with_parent()
    transport.prepare(arguments)
    os.nice(niceness)
    # rclpy ends ROS at the first Ctrl-C. Python's own answer would come on top, and out of nowhere:
    # in the middle of taking a message, rclpy makes a RuntimeError of it.
    interrupts = Interrupts()
    signal.signal(signal.SIGINT, interrupts)
    rclpy.init(args=arguments)
    node = None
    executor = None
    try:
        # One thread needs no pool, and handing a message to one costs as much as taking it. Before
        # the node, which may publish: rclpy tells of an error where a signal meets it half made.
        one = threads == 1
        executor = SingleThreadedExecutor() if one else MultiThreadedExecutor(num_threads=threads)
        node = make()
        if isinstance(node, LifecycleNode):
            node.declare_parameter(AUTOSTART, True, _AUTOSTART)
        executor.add_node(node)
        if isinstance(node, LifecycleNode):
            _autostart(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except (RCLError, InvalidHandle, NotInitializedException):
        if rclpy.ok():
            raise
        return 0  # told to end while a callback was using ROS
    except InputError as error:
        return _failed(node, error, 2)
    except OmmError as error:
        return _failed(node, error, 1)
    finally:
        interrupts.close()
        if executor is not None:
            executor.shutdown(timeout_sec=1.0)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _autostart(node: LifecycleNode) -> None:
    if not node.get_parameter(AUTOSTART).value:
        return
    for transition in (node.trigger_configure, node.trigger_activate):
        if transition() != TransitionCallbackReturn.SUCCESS:
            raise getattr(node, "failure", None) or OmmError(
                f"{node.get_name()} could not start; see above for what was wrong."
            )


def end_with_parent() -> None:
    """Have the kernel send SIGTERM when the parent is killed: launch leaves its nodes then."""
    if os.environ.get(END_WITH_PARENT) == "1":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _failed(node: Node | None, error: OmmError, status: int) -> int:
    if node is not None and rclpy.ok():
        node.get_logger().fatal(str(error))
    else:
        print(f"omm: {error}", file=sys.stderr)
    return status

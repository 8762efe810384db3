"""Transitions of lifecycle nodes that say what went wrong: rclpy itself swallows exceptions."""

import functools
import traceback
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from omm_core.errors import OmmError

N = TypeVar("N", bound=Any)
Transition = Callable[[N, LifecycleState], TransitionCallbackReturn]


def transition(method: Transition[N]) -> Transition[N]:
    """Wrap `on_configure` and the like.

    An OmmError is logged, kept as the node's `failure` (with which `run_node` ends) and leaves the
    node as it was; anything else is a defect: logged with its traceback, it leads to `on_error`.
    """

    @functools.wraps(method)
    def told(self: N, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return method(self, state)
        except OmmError as error:
            self.failure = error
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self.get_logger().fatal(traceback.format_exc())
            return TransitionCallbackReturn.ERROR

    return told

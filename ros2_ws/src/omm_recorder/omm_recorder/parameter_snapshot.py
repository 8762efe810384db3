"""The parameters of all nodes, asked for as the nodes appear. Later changes are events."""

import json
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient


class ParameterSnapshot:
    """Asks every node of the system for its parameters, once.

    Parameters
    ----------
    node
        Who asks.
    take
        Called with a node's name and its parameters as (name -> value).
    """

    def __init__(self, node: Node, take: Callable[[str, dict[str, Any]], None]) -> None:
        self._node = node
        self._take = take
        self._asked: dict[str, AsyncParameterClient] = {}
        self._taken: set[str] = set()
        self._done: list[AsyncParameterClient] = []

    def look(self) -> None:
        """Ask the nodes that are new and those that did not answer yet."""
        self._destroy_done()
        names = {
            f"{space.rstrip('/')}/{name}"
            for name, space in self._node.get_node_names_and_namespaces()
            if not name.startswith("_")
        }
        for gone in (set(self._asked) | self._taken) - names:
            self._forget(gone)
        for name in sorted(names - self._taken):
            if name not in self._asked:
                self._asked[name] = AsyncParameterClient(self._node, name)
            client = self._asked[name]
            if client.services_are_ready():
                self._taken.add(name)
                future = client.list_parameters()
                future.add_done_callback(lambda done, n=name, c=client: self._listed(n, c, done))

    def ask_again(self, name: str) -> None:
        """Ask a node once more: it may have changed. A name that is no node's is not asked."""
        self._forget(name)
        self.look()

    def _listed(self, name: str, client: AsyncParameterClient, listed: Any) -> None:
        if listed.exception() is not None or listed.result() is None:
            self._taken.discard(name)
            return
        names = list(listed.result().result.names)
        future = client.get_parameters(names)
        future.add_done_callback(lambda done: self._got(name, names, done))

    def _got(self, name: str, names: list[str], got: Any) -> None:
        if got.exception() is not None or got.result() is None:
            self._taken.discard(name)
            return
        values = [parameter_value_to_python(value) for value in got.result().values]
        self._take(name, dict(zip(names, values)))
        self._forget_client(name)

    def _forget(self, name: str) -> None:
        self._taken.discard(name)
        self._forget_client(name)

    def _forget_client(self, name: str) -> None:
        # Not at once: an answer of it may just be in the executor's hands.
        if name in self._asked:
            self._done.append(self._asked.pop(name))

    def _destroy_done(self) -> None:
        for client in self._done:
            for service in vars(client).values():
                if hasattr(service, "srv_name"):
                    self._node.destroy_client(service)
        self._done.clear()


def as_table(values: dict[str, Any]) -> dict[str, str]:
    """Return the parameters as texts, for a metadata record."""
    return {name: json.dumps(value, default=list) for name, value in sorted(values.items())}

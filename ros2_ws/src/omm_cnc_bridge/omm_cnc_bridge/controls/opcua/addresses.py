"""From what a mapping file says of a node to the node: checked, and named where it is none.

Indices of namespaces are a server's own for as long as it runs; one that is restarted may count
them anew. What an index meant when omm connected first is therefore what it goes on to mean.
"""

from __future__ import annotations

import difflib

from asyncua import Client, Node, ua
from asyncua.ua.uaerrors import UaStatusCodeError

from omm_core.errors import InputError

MOST_NODES = 1500
"""Nodes that are looked at for one that is nearly what was asked for."""
_NO_NODE = {ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid}
_FORMS = "a path of browse names (Machine/Axes/X) or a node id (nsu=URI;s=NAME, ns=2;s=NAME)"


class Addresses:
    """Resolves paths and node ids on one connection.

    Parameters
    ----------
    client : Client
        Connected.
    namespaces : list of str
        The namespaces' URIs in their order at the first connection; filled at that.
    """

    def __init__(self, client: Client, namespaces: list[str]) -> None:
        self._client, self._first = client, namespaces
        self._now: list[str] = []

    async def variable(self, path: str, what: str) -> Node:
        """Return a node that has a value.

        Parameters
        ----------
        path : str
            As the mapping file has it.
        what : str
            What it is for, for messages ("the position of axis X").

        Raises
        ------
        InputError
            Where there is none.
        """
        try:
            node = await self.find(path)
            kind = await node.read_node_class()
        except InputError as error:
            raise InputError(f"{error} It is to be {what}.") from None
        except UaStatusCodeError as error:
            if error.code not in _NO_NODE:
                return await self.find(path)  # may not be asked what it is; its value tells
            raise InputError(
                f"OPC UA: expected a node {path} as {what}, the server has none"
                f"{await self._nearest(path)}."
            ) from None
        if kind != ua.NodeClass.Variable:
            names = ", ".join(await _names_below(node)) or "nothing"
            raise InputError(
                f"OPC UA: expected a Variable as {what}, {path} is of the class {kind.name}; below"
                f" it there is {names:.400}."
            )
        return node

    async def find(self, path: str, start: Node | None = None) -> Node:
        """Return the node of a path or node id; raise InputError where there is none."""
        if "=" in path.split("/", 1)[0]:
            return self._client.get_node(await self._node_id(path))
        node = start or self._client.nodes.objects
        for name in path.split("/"):
            found = await child(node, await self._qualified(name, path))
            if found is None:
                names = await _names_below(node)
                by_lower = {n.lower(): n for n in names}
                near = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.5)
                raise InputError(
                    f"OPC UA: expected {name or 'a name'} of the path {path}, the server has"
                    f" {', '.join(names) or 'nothing':.400} there"
                    f"{f'; did you mean {by_lower[near[0]]}?' if near else '.'}"
                )
            node = found
        return node

    async def lasting(self, node: Node) -> str:
        """Return a node's id with its namespace by name, which outlasts a restart of the server."""
        text = str(node.nodeid.to_string())
        if not node.nodeid.NamespaceIndex:
            return text
        uri = (await self._present())[node.nodeid.NamespaceIndex]
        return f"nsu={uri};{text.partition(';')[2]}"

    async def _node_id(self, text: str) -> ua.NodeId:
        index = ""
        if text.startswith("nsu="):
            uri, _, text = text[4:].partition(";")
            present = await self._present()
            if uri not in present:
                near = difflib.get_close_matches(uri, present, n=1) or present
                raise InputError(
                    f"OPC UA: expected the namespace {uri} on the server, it has {', '.join(near)}."
                )
            index = f"ns={present.index(uri)};"
        try:
            node_id = ua.NodeId.from_string(index + text)
        except (ua.UaError, ValueError, TypeError):
            raise InputError(f"OPC UA: expected {_FORMS}, got {text[:80]!r}.") from None
        if not index and node_id.NamespaceIndex:
            moved = await self._index(node_id.NamespaceIndex, text)
            node_id = ua.NodeId(node_id.Identifier, moved, node_id.NodeIdType)
        return node_id

    async def _qualified(self, name: str, path: str) -> str:
        """Return a browse name whose index, if it has one, is that of today."""
        index, colon, rest = name.partition(":")
        if not colon:
            return name
        if not index.isdecimal():
            raise InputError(f"OPC UA: expected {_FORMS}, got {path[:80]!r}.")
        return f"{await self._index(int(index), path)}:{rest}"

    async def _index(self, index: int, text: str) -> int:
        """Return the present index of what was namespace ``index`` at the first connection."""
        present = await self._present()
        if index >= len(self._first):
            raise InputError(
                f"OPC UA: expected a namespace up to {len(self._first) - 1}, got {index} in"
                f" {text[:80]}; the server's are {_counted(self._first)}."
            )
        uri = self._first[index]
        if present[index : index + 1] == [uri]:
            return index
        if uri not in present:
            raise InputError(
                f"OPC UA: namespace {index} of {text[:80]} was {uri}, which the server no longer"
                f" has; it has {_counted(present)}. Write nsu=URI;… in the place of ns={index};…"
            )
        return present.index(uri)

    async def _present(self) -> list[str]:
        if not self._now:
            self._now = [str(uri) for uri in await self._client.get_namespace_array()]
            self._first[:] = self._first or self._now
        return self._now

    async def _nearest(self, path: str) -> str:
        """Return what nearly is what was asked for, in words; empty where nothing is."""
        ids: list[str] = []
        level = [self._client.nodes.objects]
        while level and len(ids) < MOST_NODES:
            below: list[Node] = []
            for node in level:
                if node.nodeid != ua.NodeId(ua.ObjectIds.Server) and len(ids) < MOST_NODES:
                    found = await node.get_children()
                    ids += [n.nodeid.to_string() for n in found]
                    below += found
            level = below
        near = difflib.get_close_matches(path, ids, n=3, cutoff=0.6)
        return f"; near it are {', '.join(dict.fromkeys(near))}" if near else ""


async def child(node: Node, name: str) -> Node | None:
    """Return a child by its browse name; a name without ``ns:`` fits any namespace."""
    wanted = ua.QualifiedName.from_string(name) if ":" in name else None
    for reference in await node.get_references(direction=ua.BrowseDirection.Forward):
        browse_name = reference.BrowseName
        if browse_name == wanted or (wanted is None and browse_name.Name == name):
            return Node(node.session, reference.NodeId)
    return None


async def _names_below(node: Node) -> list[str]:
    return [str((await c.read_browse_name()).Name) for c in await node.get_children()]


def _counted(uris: list[str]) -> str:
    return ", ".join(f"{i}: {uri}" for i, uri in enumerate(uris))

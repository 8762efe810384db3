"""What a mapping file says of a node is checked at the start, and outlasts a restart."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip("asyncua", reason="asyncua is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

from asyncua import Server, ua  # noqa: E402

from omm_cnc_bridge.controls.opcua.addresses import Addresses  # noqa: E402
from omm_cnc_bridge.controls.opcua.nodes import _refuse_shared, _unit  # noqa: E402
from omm_core.errors import InputError  # noqa: E402

URI = "urn:maker:mill"


@pytest.fixture(scope="module")
def server():
    """A server that nobody connects to: its address space is asked as a client's would be."""

    async def build() -> Server:
        made = Server()
        await made.init()
        await made.register_namespace("urn:other")
        index = await made.register_namespace(URI)
        axes = await made.nodes.objects.add_object(ua.NodeId("Axes", index), f"{index}:Axes")
        await axes.add_variable(ua.NodeId("Axes.X.act", index), f"{index}:X", 1.5)
        return made

    return asyncio.run(build())


def addresses(server, first: list[str], now: list[str] | None = None) -> Addresses:
    async def array():
        return now or await Server.get_namespace_array(server)

    client = SimpleNamespace(
        nodes=server.nodes, get_node=server.get_node, get_namespace_array=array
    )
    return Addresses(client, first)


@pytest.mark.parametrize(
    "path", ["Axes/X", "3:Axes/3:X", "ns=3;s=Axes.X.act", f"nsu={URI};s=Axes.X.act"]
)
def test_a_node_is_named_by_a_path_or_by_its_id(server, path):
    node = asyncio.run(addresses(server, []).variable(path, "the position of axis X"))
    assert node.nodeid.Identifier == "Axes.X.act"


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("ns=3;s=Axes.X.akt", r"near it are ns=3;s=Axes\.X\.act"),
        ("ns=3;s=Axes", "of the class Object; below it there is X"),
        ("ns=three;s=Axes", "a path of browse names"),
        ("ns=3;x=Axes", "a path of browse names"),
        ("i=abc", "a path of browse names"),
        ("nsu=urn:maker:mil;s=Axes.X.act", f"it has {URI}"),
        (f"nsu={URI}", "a path of browse names"),
        ("ns=9;s=Axes.X.act", "a namespace up to 3"),
        ("Axes/x", "did you mean X"),
        ("Axes/", "a name of the path"),
        ("three:Axes", "a path of browse names"),
    ],
)
def test_what_is_no_node_with_a_value_is_bad_input_that_says_what_is_near(server, path, words):
    with pytest.raises(InputError, match=words) as caught:
        asyncio.run(addresses(server, []).variable(path, "the position of axis X"))
    assert "Axes/" in path or "position of axis X" in str(caught.value)


def test_an_index_goes_on_to_mean_the_namespace_that_it_meant_at_first(server):
    """The server was restarted; what was 2 is 3 now, and 2 is another's."""
    standard, own = asyncio.run(Server.get_namespace_array(server))[:2]
    first = [standard, own, URI, "urn:other"]
    for path in ("ns=2;s=Axes.X.act", "2:Axes/2:X"):
        node = asyncio.run(addresses(server, list(first)).variable(path, "the position"))
        assert node.nodeid.NamespaceIndex == 3
    gone = [standard, own, "urn:gone"]
    with pytest.raises(InputError, match="was urn:gone, which the server no longer has"):
        asyncio.run(addresses(server, gone).variable("ns=2;s=Axes.X.act", "the position"))


def test_what_is_found_by_browsing_is_kept_by_the_namespaces_name(server):
    one = addresses(server, [])
    node = asyncio.run(one.find("Axes/X"))
    assert asyncio.run(one.lasting(node)) == f"nsu={URI};s=Axes.X.act"


@pytest.mark.parametrize(
    ("code", "text", "unit"),
    [
        ("MMT", "mm", "mm"), ("MMT", "Millimeter", "mm"), ("", "inch", "inch"),
        ("4H", "µm", "um"), ("MMT", "inch", "MMT (inch)"), ("KGM", "kg", "kg"),
        ("", "", None),
    ],
)  # fmt: skip
def test_a_unit_whose_code_and_words_contradict_each_other_is_none(server, code, text, unit):
    async def told():
        node = await server.nodes.objects.add_variable(3, f"u{code}{text}", 0.0)
        units = ua.EUInformation(
            UnitId=int.from_bytes(code.encode(), "big"), DisplayName=ua.LocalizedText(text)
        )
        await node.add_property(0, "EngineeringUnits", units)
        return await _unit(node)

    assert asyncio.run(told()) == unit


def test_two_axes_with_one_node_for_their_position_are_refused(server):
    node = asyncio.run(addresses(server, []).find("Axes/X"))
    _refuse_shared({("X", "position"): node, ("Y", "status"): node})
    with pytest.raises(InputError, match=r"Axes\.X\.act for X and Y"):
        _refuse_shared({("X", "position"): node, ("Y", "position"): node})

"""Commands are checked, recorded, and carried out once, however often they come."""

import asyncio

from omm_operator.screen.commands import Command
from omm_operator.screen.desk import TWIN_S, Answer, Asker, Desk
from omm_report.language import Said, say

OPERATOR = Asker(who="127.0.0.1 a", role="operator")
OTHER = Asker(who="127.0.0.1 b", role="operator")
VIEWER = Asker(who="10.0.0.7 c", role="viewer")


class Bench:
    """A desk, what it carried out, and what it recorded."""

    def __init__(self, refused: Said | None = None) -> None:
        self.now_s = 0.0
        self.carried: list[str] = []
        self.recorded: list[tuple[str, str, object]] = []
        self.desk = Desk(lambda command: refused, self.carry, self.record, lambda: self.now_s)

    async def carry(self, command: Command) -> Answer:
        await asyncio.sleep(0.01)
        self.carried.append(command.name)
        return Answer(accepted=True, said=say("done.new_clamping"))

    def record(self, asker: Asker, command: Command, answer: Answer | None) -> None:
        self.recorded.append((asker.who, command.name, None if answer is None else answer.accepted))


def command(key: str, name: str = "new_clamping", **arguments: object) -> Command:
    return Command(name=name, key=key, arguments=arguments)


def test_a_double_tap_is_one_command() -> None:
    async def tap() -> None:
        bench = Bench()
        answers = await asyncio.gather(
            bench.desk.take(OPERATOR, command("first-key")),
            bench.desk.take(OPERATOR, command("second-key")),
        )
        assert [a.accepted for a in answers] == [True, True]
        assert bench.carried == ["new_clamping"]

    asyncio.run(tap())


def test_two_pages_at_once_are_one_command() -> None:
    async def tap() -> None:
        bench = Bench()
        await asyncio.gather(
            bench.desk.take(OPERATOR, command("page-a-key")),
            bench.desk.take(OTHER, command("page-b-key")),
        )
        assert bench.carried == ["new_clamping"]

    asyncio.run(tap())


def test_a_command_that_is_sent_again_later_gets_its_first_answer() -> None:
    async def again() -> None:
        bench = Bench()
        await bench.desk.take(OPERATOR, command("same-key"))
        bench.now_s += 100 * TWIN_S
        await bench.desk.take(OPERATOR, command("same-key"))
        assert bench.carried == ["new_clamping"]
        await bench.desk.take(OPERATOR, command("another-key"))
        assert bench.carried == ["new_clamping"] * 2

    asyncio.run(again())


def test_another_command_is_no_twin() -> None:
    async def both() -> None:
        bench = Bench()
        await bench.desk.take(OPERATOR, command("key-number-1", "acknowledge", number=1))
        await bench.desk.take(OPERATOR, command("key-number-2", "acknowledge", number=2))
        assert bench.carried == ["acknowledge"] * 2

    asyncio.run(both())


def test_a_page_that_goes_away_does_not_stop_its_command() -> None:
    async def leave() -> None:
        bench = Bench()
        waiting = asyncio.ensure_future(bench.desk.take(OPERATOR, command("first-key")))
        await asyncio.sleep(0)
        waiting.cancel()
        answer = await bench.desk.take(OPERATOR, command("first-key"))
        assert answer.accepted
        assert bench.carried == ["new_clamping"]

    asyncio.run(leave())


def test_every_command_is_recorded_with_who_and_what_became_of_it() -> None:
    async def give() -> None:
        bench = Bench()
        await bench.desk.take(OPERATOR, command("first-key"))
        assert bench.recorded == [
            (OPERATOR.who, "new_clamping", None), (OPERATOR.who, "new_clamping", True)
        ]  # fmt: skip
        refusing = Bench(refused=say("command.program_runs"))
        answer = await refusing.desk.take(OPERATOR, command("first-key"))
        assert not answer.accepted
        assert refusing.carried == []
        assert refusing.recorded == [(OPERATOR.who, "new_clamping", False)]

    asyncio.run(give())


def test_a_viewer_commands_nothing() -> None:
    async def give() -> None:
        bench = Bench()
        answer = await bench.desk.take(VIEWER, command("first-key", "acknowledge", number=0))
        assert not answer.accepted
        assert bench.carried == []
        assert bench.recorded == [(VIEWER.who, "acknowledge", False)]

    asyncio.run(give())

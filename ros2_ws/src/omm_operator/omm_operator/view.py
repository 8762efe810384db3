"""What the operator sees while a part is measured: images, targets, what is missing."""

from dataclasses import dataclass, field

from omm_interfaces.msg import PartEstimate, SpindleState
from rclpy.node import Node
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from omm_ros import qos, topics

_PROGRAM_WORDS = {
    SpindleState.PROGRAM_UNKNOWN: "no program known",
    SpindleState.PROGRAM_STOPPED: "program stopped",
    SpindleState.PROGRAM_RUNNING: "program running",
    SpindleState.PROGRAM_WAITING: "program waits for an image",
    SpindleState.PROGRAM_INTERRUPTED: "program interrupted",
    SpindleState.PROGRAM_FINISHED: "program finished",
}


@dataclass(kw_only=True)
class Progress:
    """The newest that was heard of the machine and of the estimate."""

    state: SpindleState | None = None
    estimate: PartEstimate | None = None
    counted: dict[int, int] = field(default_factory=dict)

    @property
    def program_finished(self) -> bool:
        """Whether the control's program has come to its end."""
        return self.state is not None and self.state.program_state == SpindleState.PROGRAM_FINISHED

    @property
    def images_judged(self) -> int:
        """How many images the estimator has judged."""
        return 0 if self.estimate is None else len(self.estimate.images)

    @property
    def images_missing(self) -> int:
        """How many images the program asked for that have not come."""
        asked = 0 if self.state is None else self.state.measure_acknowledged
        return max(0, asked - self.images_judged)

    @property
    def came_to_an_end(self) -> bool:
        """The program has ended, and all images that came have been judged."""
        return (
            self.program_finished
            and self.estimate is not None
            and self.estimate.images_pending == 0
        )

    @property
    def settled(self) -> bool:
        """Everything that the program asked for has arrived and has been judged."""
        return self.came_to_an_end and self.images_missing == 0


class OperatorView:
    """Listens to a measurement and shows it: a live panel on a terminal, lines elsewhere."""

    def __init__(self, node: Node, console: Console) -> None:
        self.progress = Progress()
        self._console = console
        self._shown = ""
        node.create_subscription(SpindleState, topics.SPINDLE_STATE, self._on_state, qos.STATE)
        node.create_subscription(PartEstimate, topics.ESTIMATE, self._on_estimate, qos.LATCHED)
        self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> "OperatorView":
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._live.stop()

    def show(self) -> None:
        """Update what is shown."""
        if self._console.is_terminal:
            self._live.update(self._panel(), refresh=True)
            return
        line = self._line()
        if line != self._shown:
            self._shown = line
            self._console.print(line, highlight=False)

    def _on_state(self, message: SpindleState) -> None:
        self.progress.state = message

    def _on_estimate(self, message: PartEstimate) -> None:
        self.progress.estimate = message

    def _line(self) -> str:
        estimate = self.progress.estimate
        if estimate is None:
            return "  waiting for the machine"
        seen = ", ".join(f"{t.id}: {t.images}×" for t in estimate.targets)
        solved = "solved" if estimate.determined else "not yet determined"
        return f"  {len(estimate.images)} images, targets seen {seen}; {solved}"

    def _panel(self) -> RenderableType:
        state, estimate = self.progress.state, self.progress.estimate
        words = "waiting for the machine" if state is None else _PROGRAM_WORDS[state.program_state]
        rows: list[RenderableType] = [Text(f"  {words}", style="bold")]
        if estimate is not None:
            rows.append(_targets(estimate))
            rows += [Text(f"  {text}", style="yellow") for text in estimate.missing]
            rows += [Text(f"  {text}", style="red") for text in estimate.findings]
            of = len(estimate.images)
            rows += [
                Text(f"  image {n} of {of}: {image.reason}")
                for n, image in enumerate(estimate.images, start=1)
                if not image.used
            ]
        return Group(*rows)


def _targets(estimate: PartEstimate) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2))
    for target in estimate.targets:
        style = "green" if target.images >= 2 else "yellow" if target.images else "red"
        table.add_row(f"  target {target.id}", Text(f"{target.images} images", style=style))
    used = sum(image.used for image in estimate.images)
    table.add_row("  images", f"{used} used of {estimate.images_received}")
    if estimate.determined:
        table.add_row("  residuals", f"{estimate.rms_px:.4f} px RMS")
    return table

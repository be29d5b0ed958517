"""What a person sees while the simulation flies: one live line of phase, views, coverage, path and planning."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from uav_recon.app.flight_channels import FlightChannels
from uav_recon.types.vehicle import MissionProgress


class ProgressDisplay:
    """A live line; on a dumb terminal or in a log, a plain line at each change of phase and every ten views."""

    def __init__(self, console: Console, wires: FlightChannels) -> None:
        self._console, self._wires = console, wires
        self._live = Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None
        self._last = ("", -1)

    def __enter__(self) -> ProgressDisplay:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._live:
            self._live.stop()

    def show(self) -> bool:
        """Show the newest progress; False while the mission has not reported yet."""
        progress = self._wires.progress.latest()
        if progress is None:
            self._waiting()
            return False
        if self._live:
            self._live.update(_line(progress))
        mark = (progress.phase, progress.views // 10)
        if mark != self._last and not self._live:
            self._console.print(_line(progress).plain.rstrip(), markup=False, highlight=False, soft_wrap=True)
        self._last = mark
        return True

    def _waiting(self) -> None:
        text = Text("starting the processes and waiting for the vehicle ...", style="dim")
        if self._live:
            self._live.update(text)
        elif self._last != ("waiting", -1):
            self._console.print(text)
            self._last = ("waiting", -1)


def _line(progress: MissionProgress) -> Text:
    filled = round(20 * progress.views / max(progress.views_budget, 1))
    return Text.assemble(
        (f"{progress.phase:8} ", "bold cyan"),
        f"{progress.mode:7}  views {progress.views:3}/{progress.views_budget} {'█' * filled:░<20}  ",
        f"explored {progress.explored_m3:5.1f} m³  path {progress.path_length_m:5.1f} m  ",
        f"plans {progress.plans} in {progress.planning_s:.2f} s  ",
        (progress.note, "yellow"),
        no_wrap=True,
        overflow="ellipsis",
    )

"""Progress of a simulated flight: one live line of phase, views, coverage, path, planning."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from uav_recon.app.flight_channels import FlightChannels
from uav_recon.types.reason import text_of
from uav_recon.types.vehicle import FlightPhase, MissionProgress

LINE_PERIOD_S = 10.0  # longest time without a line, where the console is no terminal
LANDED_S = 2.0  # after it the flight line gives way to what runs on the ground


class ProgressDisplay:
    """A live line on a terminal; elsewhere a line at each change of phase and every ten views."""

    def __init__(self, console: Console, channels: FlightChannels) -> None:
        self._console = console
        self._channels = channels
        self._live = Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None
        self._last = ("", -1)
        self._begun_s = self._printed_s = time.monotonic()
        self._landed_s: float | None = None

    def __enter__(self) -> ProgressDisplay:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._live:
            self._live.stop()

    def show(self) -> bool:
        """Show the newest progress; return False while the mission has not reported yet."""
        progress, now_s = self._channels.progress.latest(), time.monotonic()
        if progress is None:
            waited_s = now_s - self._begun_s
            self._put(Text(f"starting the processes, waiting for the vehicle: {waited_s:.0f} s", "dim"), ("starting", 0))
            return False
        landed_for_s = self._landed_for_s(now_s)
        if landed_for_s > LANDED_S:
            text = f"landed: training the final model, meshing, writing the report: {landed_for_s:.0f} s"
            self._put(Text(text, "bold cyan"), ("landed", 0))
        else:
            self._put(_line(progress), (progress.phase, progress.views // 10))
        return True

    def _put(self, line: Text, mark: tuple[str, int]) -> None:
        """Show a line.

        A terminal shows it at once. Elsewhere it is printed if the mark changed or the last line is LINE_PERIOD_S ago.
        """
        now_s = time.monotonic()
        if self._live:
            self._live.update(line)
        elif mark != self._last or now_s - self._printed_s > LINE_PERIOD_S:
            self._console.print(line.plain.rstrip(), markup=False, highlight=False, soft_wrap=True)
            self._printed_s = now_s
        self._last = mark

    def _landed_for_s(self, now_s: float) -> float:
        vehicle = self._channels.vehicle.latest()
        if vehicle is None or vehicle.phase is not FlightPhase.LANDED:
            self._landed_s = None
        elif self._landed_s is None:
            self._landed_s = now_s
        return 0.0 if self._landed_s is None else now_s - self._landed_s


def _line(progress: MissionProgress) -> Text:
    filled = round(20 * progress.views / max(progress.views_budget, 1))
    return Text.assemble(
        (f"{progress.phase:8} ", "bold cyan"),
        f"{progress.mode:7}  views {progress.views:3}/{progress.views_budget} {'█' * filled:░<20}  ",
        f"explored {progress.explored_m3:5.1f} m³  path {progress.path_length_m:5.1f} m  ",
        f"plans {progress.plans} in {progress.planning_s:.2f} s  ",
        (text_of(progress.note), "yellow"),
        no_wrap=True,
        overflow="ellipsis",
    )

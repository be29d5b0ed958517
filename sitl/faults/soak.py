"""Scenario G9: flights of up to two hours without growth of memory or descriptors.

A pilot process flies only one flight, so this one flight has to last. The operator holds the vehicle in the air, lets it
continue for short periods while there is space left to explore, and lands it at the end. The battery stays full.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from sitl.faults.fault import Onset
from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.injectors.vehicle_and_autopilot import BatteryDrain
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.resource_usage import ResourceUsage
from sitl.faults.table.acceptance_limits import NO_FAILSAFE, STEADY, STREAMS, down, lands_no_sooner
from sitl.faults.table.scenario import Limit, Scenario
from sitl.runtime.die_with_parent import die_with_parent_command

# the mission continues every RESUME_PERIOD_S, for RESUME_FOR_S, RESUME_COUNT times
RESUME_PERIOD_S = 30.0
RESUME_FOR_S = 5.0
RESUME_COUNT = 10
HEAP_FLUCTUATION_MB = 2.3  # range of perception's heap size while frames are allocated and freed
_DOWN_S = 60.0  # from the land command until the motors stop


class OperatorCommands(Injector):
    """Operator commands on the command line, each at its time and in a separate process."""

    needs = Capabilities.PROCESSES

    def __init__(self, orders: Sequence[tuple[float, str]]) -> None:
        self._orders = list(orders)
        self._orders_sent = list[subprocess.Popen[bytes]]()

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Give the commands that are due, without waiting for a reply."""
        while self._orders and since_s >= self._orders[0][0]:
            command = [sys.executable, "-m", "uav_recon", self._orders.pop(0)[1], "--config", str(at.config)]
            self._orders_sent.append(subprocess.Popen(die_with_parent_command(command), stdout=subprocess.DEVNULL))  # noqa: S603 - our own program
        self._orders_sent = [each for each in self._orders_sent if each.poll() is None]

    def end(self, at: InjectionContext) -> None:
        """Wait for the processes of all commands."""
        for each in self._orders_sent:
            each.wait()


def orders(for_s: float) -> list[tuple[float, str]]:
    """Return the operator commands of a soak that ends after for_s, as (seconds, command)."""
    goes_s = [RESUME_PERIOD_S * (k + 1) for k in range(RESUME_COUNT) if RESUME_PERIOD_S * (k + 1) + RESUME_FOR_S < for_s]
    pauses = [order for go_s in goes_s for order in ((go_s, "start"), (go_s + RESUME_FOR_S, "hold"))]
    return [(0.0, "hold"), *pauses, (for_s, "land")]


def soak(name: str, said: str, for_s: float, pilot_mb_per_h: float, perception_mb_per_h: float) -> Scenario:
    """Return a soak scenario of for_s seconds with limits on the growth of memory.

    Over minutes, no slope can be detected that is smaller than what a process allocates and frees all the time, which is
    HEAP_FLUCTUATION_MB in perception. The steepest slope that this alone can cause is 1.5 HEAP_FLUCTUATION_MB over the observed
    time: less memory in the first half, more in the second.
    """
    return Scenario(
        name,
        f"soak of {said}",
        "the operator holds the vehicle in the air with a full battery; every process is sampled once a second",
        limits=(
            Limit("pilot grows by", m.noted("pilot MB/h"), pilot_mb_per_h, "MB/h"),
            Limit("perception grows by", m.noted("perception MB/h"), perception_mb_per_h, "MB/h"),
            *(Limit(f"{who}'s new descriptors", m.noted(f"{who} descriptors"), 0.0, "") for who in ("pilot", "perception")),
            Limit("processes that ended", m.noted("ended"), 0.0, ""),
            lands_no_sooner(for_s),
            down(for_s + _DOWN_S),
            STREAMS,
            STEADY,
            NO_FAILSAFE,
        ),
        onset=Onset((5.0, 5.0), speed_mps=0.0),
        observe_s=for_s + 2 * _DOWN_S,
        views=400,
        why="needs processes: flown in real time",
        live=lambda n: [OperatorCommands(orders(for_s)), BatteryDrain(1.0), ResourceUsage(for_s)],
    )


SOAKS = (
    soak("G9-2h", "two hours", 7200.0, 1.0, 1.0),
    soak("G9-5min", "five minutes", 300.0, 12.0, 52.0),
    soak("G9-1min", "one minute", 60.0, 60.0, 260.0),
)

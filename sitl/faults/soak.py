"""Row G9: one flight for hours, in which memory and descriptors of all processes are to stay what they are.

A pilot flies one flight in its life, so the flight itself has to last: the operator holds the vehicle in the air, lets it go
on now and then while there is something left to explore, and has it land in the end. Its battery stays full.
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

EVERY_S, FOR_S, TIMES = 30.0, 5.0, 10  # so often, for so long and so many times it goes on
BREATH_MB = 2.3  # between the least and the most that perception's heap has while frames come and go
_DOWN_S = 60.0  # from the order to land until the motors stand


class Told(Injector):
    """The operator's orders by the command line, each at its second, with a process of its own."""

    needs = Capabilities.PROCESSES

    def __init__(self, orders: Sequence[tuple[float, str]]) -> None:
        self._orders, self._told = list(orders), list[subprocess.Popen[bytes]]()

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Say what is due; nobody waits for an answer."""
        while self._orders and since_s >= self._orders[0][0]:
            command = [sys.executable, "-m", "uav_recon", self._orders.pop(0)[1], "--config", str(at.config)]
            self._told.append(subprocess.Popen(die_with_parent_command(command), stdout=subprocess.DEVNULL))  # noqa: S603 - our own program
        self._told = [each for each in self._told if each.poll() is None]

    def end(self, at: InjectionContext) -> None:
        """None is left."""
        for each in self._told:
            each.wait()


def orders(for_s: float) -> list[tuple[float, str]]:
    """Of a soak that ends after for_s."""
    goes_s = [EVERY_S * (k + 1) for k in range(TIMES) if EVERY_S * (k + 1) + FOR_S < for_s]
    pauses = [order for go_s in goes_s for order in ((go_s, "start"), (go_s + FOR_S, "hold"))]
    return [(0.0, "hold"), *pauses, (for_s, "land")]


def soak(name: str, said: str, for_s: float, pilot_mb_per_h: float, perception_mb_per_h: float) -> Scenario:
    """A row of that length, and by how much memory may grow. Over minutes no slope is seen that is less than what a process
    takes and gives back all the time: BREATH_MB in perception. The steepest line is that of a first half with less and a second
    with more, 1.5 BREATH_MB over the time that is looked at.
    """
    return Scenario(
        name,
        f"soak of {said}",
        "held in the air by the operator with a full battery; every process looked at once a second",
        bars=(
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
        longest_s=for_s + 2 * _DOWN_S,
        views=400,
        why="needs processes: flown in real time",
        live=lambda n: [Told(orders(for_s)), BatteryDrain(1.0), ResourceUsage(for_s)],
    )


SOAKS = (
    soak("G9-2h", "two hours", 7200.0, 1.0, 1.0),
    soak("G9-5min", "five minutes", 300.0, 12.0, 52.0),
    soak("G9-1min", "one minute", 60.0, 60.0, 260.0),
)

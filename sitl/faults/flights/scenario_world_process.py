"""The simulator process of a real-time fault scenario.

Run as `python -m sitl.faults.flights.scenario_world_process OPTIONS.json`.
"""

from __future__ import annotations

import contextlib
import json
import pickle
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from sitl.apps.world_process import WorldOptions, binary_of, make_firmware_world, make_world, run
from sitl.autopilots.byte_links import UdpPeer
from sitl.faults.autopilot_side_proxy import AutopilotSideProxy
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.collect_evidence import evidence_of
from sitl.faults.process_registry import ProcessRegistry
from sitl.faults.table.all_scenarios import ROWS
from sitl.faults.table.arenas import arena
from sitl.outside_world import OutsideWorld
from sitl.real_firmware.process import FirmwareError
from sitl.real_firmware.relay import Relay
from sitl.runtime.serial_line import SerialLine
from uav_recon import config as product_config
from uav_recon.clock import RateKeeper

LONGEST_WAIT_S = 300.0  # for the trouble's moment: the product compiles first
TURN_S = 1.0 / 60.0  # of the ledger and of the troubles


@dataclass(frozen=True)
class WorldProcessOptions:
    """world: a file of WorldOptions. row, number: whose trouble, and which of its cases. config: of the product. firmware: the
    path of a real one in the simulated autopilot's place, behind a relay that the troubles of the link can reach. line: the
    name of the serial line that the link is, where it is one.
    """

    world: str
    row: str
    number: int
    config: str
    firmware: str | None = None
    line: str | None = None

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")


def fly(order: WorldProcessOptions) -> FlightEvidence:
    """Run until there is nothing left to see. Raises OSError if a port cannot be had, FirmwareError."""
    options, row = WorldOptions.load(Path(order.world)), ROWS[order.row]
    trouble = Fault(row.id, row.troubles(order.number, live=True), row.onset, row.observe_s, row.observe_after_disarm_s)
    meddler = FaultDirector([trouble], order.number, LONGEST_WAIT_S)
    with contextlib.ExitStack() as ends:
        line = None if order.line is None else SerialLine(Path(order.line))
        end = ends.enter_context(contextlib.closing(line or UdpPeer(remote=("127.0.0.1", options.port))))
        world, relay = _outside(order, options, meddler.autopilot_link(end), ends)
        meddler.enter(world, None, time.monotonic())
        at = meddler.context
        at.config, at.roster, at.line = Path(order.config), ProcessRegistry(Path(options.stream).parent), line
        _fly(world, relay, meddler)
        world.truth_log.save(Path(options.truth), world)
    return evidence_of(meddler, product_config.load(Path(order.config)), Path(options.truth), options.radius_m)


def _outside(
    order: WorldProcessOptions, options: WorldOptions, product: AutopilotSideProxy, ends: contextlib.ExitStack
) -> tuple[OutsideWorld, Relay | None]:
    """The world with what flies in it, and what carries its words if that is a program of its own."""
    scene = arena(ROWS[order.row].arena, options.radius_m)
    if order.firmware is None:
        return make_world(options, scene, product, time.monotonic), None
    binary = Path(order.firmware)
    relay = ends.enter_context(contextlib.closing(Relay(product, binary_of(options.autopilot, binary).companion_port)))
    return make_firmware_world(binary, options, scene, relay.port, ends), relay


def _fly(world: OutsideWorld, relay: Relay | None, meddler: FaultDirector) -> None:
    """Until it is over."""
    turns = RateKeeper(1.0 / TURN_S, time.monotonic())

    def ended(now_s: float) -> bool:
        if relay is not None:
            relay.pass_on()
        if turns.due(now_s):
            meddler.turn(now_s)
        return meddler.over(finished=False)

    run(world, ended)


def main(order: Path) -> None:
    """Fly as ordered; the evidence is left beside the order."""
    evidence = fly(WorldProcessOptions(**json.loads(order.read_text(encoding="utf-8"))))
    fresh = order.with_suffix(".new")
    fresh.write_bytes(pickle.dumps(evidence))
    fresh.replace(order.with_suffix(".evidence"))


if __name__ == "__main__":
    sys.setswitchinterval(0.001)
    try:
        main(Path(sys.argv[1]))
    except FirmwareError as error:
        sys.exit(str(error))

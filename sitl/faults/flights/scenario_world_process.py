"""The simulator process of a real-time fault scenario.

Run as `python -m sitl.faults.flights.scenario_world_process OPTIONS.json`.
"""

from __future__ import annotations

import contextlib
import pickle
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from sitl.apps.world_process import WorldOptions, binary_of, make_firmware_world, make_world, run
from sitl.autopilots.byte_links import UdpPeer
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.collect_evidence import evidence_of
from sitl.faults.mavlink_proxy import MavlinkProxy
from sitl.faults.process_registry import ProcessRegistry
from sitl.faults.table.all_scenarios import SCENARIOS
from sitl.faults.table.arenas import arena
from sitl.faults.table.scenario import standing_conditions
from sitl.outside_world import OutsideWorld
from sitl.real_firmware.process import FirmwareError
from sitl.real_firmware.relay import Relay
from sitl.runtime import atomic_file
from sitl.runtime.serial_line import SerialLine
from uav_recon import config as product_config
from uav_recon import json_codec
from uav_recon.clock import RateKeeper

LONGEST_WAIT_S = 300.0  # for the onset of the fault; the product compiles its kernels first
TURN_S = 1.0 / 60.0  # period of the truth samples and of the faults


@dataclass(frozen=True)
class WorldProcessOptions:
    """Options of the process.

    world: file with WorldOptions.
    scenario, number: its identifier, and number of the flight, which selects its case.
    config: config file of the product.
    firmware: path of a real firmware in place of the simulated autopilot. It runs behind a relay to which the link faults
    apply.
    line: name of the serial line, if the link is one.
    """

    world: str
    scenario: str
    number: int
    config: str
    firmware: str | None = None
    line: str | None = None

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json_codec.to_line(self), encoding="utf-8")


def fly(order: WorldProcessOptions) -> FlightEvidence:
    """Run until the observation ends. Raises OSError if a port cannot be opened, FirmwareError."""
    options, scenario = WorldOptions.load(Path(order.world)), SCENARIOS[order.scenario]
    fault = Fault(
        scenario.id,
        scenario.injectors_of(order.number, live=True),
        scenario.onset,
        scenario.observe_s,
        scenario.observe_after_disarm_s,
    )
    conditions = standing_conditions(scenario.claimed_m)
    director = FaultDirector([fault], order.number, LONGEST_WAIT_S, conditions=conditions)
    with contextlib.ExitStack() as ends:
        line = None if order.line is None else SerialLine(Path(order.line))
        end = ends.enter_context(contextlib.closing(line or UdpPeer(remote=("127.0.0.1", options.port))))
        world, relay = _outside(order, options, director.autopilot_link(end), ends)
        director.enter(world, None, time.monotonic())
        at = director.context
        at.config, at.registry, at.line = Path(order.config), ProcessRegistry(Path(options.stream).parent), line
        _fly(world, relay, director)
        world.truth_log.save(Path(options.truth), world)
    return evidence_of(director, product_config.load(Path(order.config)), Path(options.truth), options.radius_m)


def _outside(
    order: WorldProcessOptions, options: WorldOptions, product: MavlinkProxy, ends: contextlib.ExitStack
) -> tuple[OutsideWorld, Relay | None]:
    """Return the world with its vehicle, and the relay for a real firmware.

    The relay is None for a simulated autopilot.
    """
    scenario = SCENARIOS[order.scenario]
    scene = arena(scenario.arena, options.radius_m, painted=scenario.poses != "stream")  # what tracks by images needs texture
    if order.firmware is None:
        return make_world(options, scene, product, time.monotonic), None
    binary = Path(order.firmware)
    relay = ends.enter_context(contextlib.closing(Relay(product, binary_of(options.autopilot, binary).companion_port)))
    return make_firmware_world(binary, options, scene, relay.port, ends), relay


def _fly(world: OutsideWorld, relay: Relay | None, director: FaultDirector) -> None:
    """Run the world until the flight is over."""
    turns = RateKeeper(1.0 / TURN_S, time.monotonic())

    def ended(now_s: float) -> bool:
        if relay is not None:
            relay.pass_on()
        if turns.due(now_s):
            director.turn(now_s)
        return director.over(finished=False)

    run(world, ended)


def main(order: Path) -> None:
    """Fly with these options; the evidence is written beside the options file."""
    evidence = fly(json_codec.from_text(WorldProcessOptions, order.read_text(encoding="utf-8")))
    atomic_file.replace(order.with_suffix(".evidence"), pickle.dumps(evidence))


if __name__ == "__main__":
    sys.setswitchinterval(0.001)
    try:
        main(Path(sys.argv[1]))
    except FirmwareError as error:
        sys.exit(str(error))

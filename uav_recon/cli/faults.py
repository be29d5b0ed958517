"""`uav-recon faults`: the fault-injection campaign."""

from __future__ import annotations

from sitl.faults.flights.fault_options import FaultOptions

EXAMPLES = (
    "uav-recon faults --list                                  # every scenario with its limits",
    "uav-recon faults --only A1,B4 --seeds 3 --out faults/    # two scenarios, with an HTML report",
    "uav-recon faults --real-time --autopilot px4             # scenarios that need real processes and signals",
    "uav-recon faults --only B1 --autopilot ardupilot --firmware ./arducopter",
)


def faults(options: FaultOptions) -> int:
    """Run the fault-injection campaign, one fault per flight.

    Flies on a simulated clock (lockstep) unless --real-time or --firmware is given. Prints one line per scenario: measured
    value and limit. Results are computed from the simulator's ground truth and the captured MAVLink traffic. docs/hazards.md
    describes the scenarios. Exit code 1 if any scenario failed.
    """
    if options.show_list:
        from sitl.faults.flights.scenario_list import print_scenarios

        return print_scenarios(options.only)
    from sitl.faults.flights.campaign import faults as fly_all

    return fly_all(options)

"""`uav-recon sim`, `uav-recon sweep` and `uav-recon compile`: flights in simulation."""

from __future__ import annotations

from sitl.apps.sim_options import SimOptions
from sitl.apps.sweep_options import SweepOptions
from uav_recon.cli.exit_codes import exit_with

SIM_EXAMPLES = (
    "uav-recon sim                                            # the built-in room, in real time",
    "uav-recon sim --lockstep --views 20 --seed 3             # repeatable; the same seed gives the same flight",
    "uav-recon sim --lockstep --mapper depth-only             # without the neural mapper: much faster",
    "uav-recon sim --scene random:7 --variant explore         # a generated flat",
    "uav-recon sim --scene small:3                            # a generated small room",
    "uav-recon sim --scene room.ply --start 1.5,2,0,90        # your own mesh: metres, z up",
    "uav-recon sim --autopilot ardupilot --firmware ./arducopter",
)
SWEEP_EXAMPLES = (
    "uav-recon sweep --flights 20",
    "uav-recon sweep --scenes built-in,random --radii 0.15,0.20 --json sweep.json",
)


def sim(options: SimOptions) -> int:
    """Fly a whole mission in simulation and write a flight folder.

    The folder holds model, report and recording. Scene, camera and autopilot are simulated. The pilot, perception and
    mission processes are the programs that run on a drone. Ctrl-C lands and still writes the report; a second Ctrl-C ends
    all processes at once.

    Exit code 0: mission completed; 1: not completed, or a process failed; 2: bad option; 130: interrupted before take-off.
    """
    if options.list_scenes:
        from sitl.apps.scene_list import print_scenes

        return print_scenes()
    from sitl.apps.sim import simulate

    return simulate(options)


def sweep(options: SweepOptions) -> int:
    """Fly many missions in lockstep with the depth-only mapper.

    Lockstep is a simulated clock: repeatable and faster than real time. Prints one line per flight and a summary table. The
    flights take all scenes, radii, variants, mounts and autopilots in turn, then again with the next seed. Exit code 1 if any
    flight had contact or failed with an error; the command that repeats such a flight is printed.
    """
    from sitl.apps.sweep import sweep as fly_all

    return fly_all(options)


def compile_kernels() -> None:
    """Compile the numerical kernels now, so that the first flight does not wait for them.

    It takes about two minutes on two cores, and nothing if all are compiled. The kernels are kept in the package, or in
    NUMBA_CACHE_DIR if set: set it as the services do (/var/cache/uav_recon), and run as their user. Exit code 1 if a kernel
    cannot be compiled.
    """
    from sitl.apps.kernel_compilation import compile_all

    exit_with(compile_all)

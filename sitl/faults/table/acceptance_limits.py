"""Limits that many scenarios share.

Values come from the budget in the list of hazards, or from measurements where real firmware differed.
"""

from __future__ import annotations

from sitl.faults.injectors import operator_silence
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.statustext_checks import statustext_delay
from sitl.faults.table.scenario import Limit

STREAM_GAP_S = 0.25  # longest gap in the setpoint stream on a machine without a real-time kernel


def holds(within_s: float, late_s: float = 0.0) -> Limit:
    """Return a limit for the time until braking to rest is commanded."""
    return Limit("hold commanded", m.held_after(late_s), within_s, "s")


def lands(within_s: float, late_s: float = 0.0, ardupilot: float | None = None) -> Limit:
    """Return a limit for the time until the autopilot is in its landing mode."""
    return Limit("landing mode", m.landing_after(late_s), within_s, "s", ardupilot=ardupilot)


# PX4 lands 0.6 to 1.3 s after the last setpoint that it received (measured), and one may be in transit as the fault begins.
UNHEARD_LANDS = lands(1.35, ardupilot=2.5)


# PX4 continues with the last received setpoint until it lands; its limit is the one for disarming.
UNHEARD_STANDS = Limit("forward speed below 0.1 m/s", m.stopped_after(0.1), 30.0, "s", ardupilot=1.5)


def lands_no_sooner(after_s: float, late_s: float = 0.0) -> Limit:
    """Return a limit for the earliest time of the landing mode."""
    return Limit("landing mode not before", m.landing_after(late_s), after_s, "s", at_least=True)


def flies_on(within_s: float, late_s: float) -> Limit:
    """Return a limit for the time until setpoints move again, after a fault of late_s."""
    return Limit("setpoints move again", m.moves_again_after(late_s), within_s, "s")


def down(within_s: float) -> Limit:
    """Return a limit for the time until the motors stop."""
    return Limit("disarmed", m.disarmed_after(), within_s, "s")


def stops(within_m: float, late_s: float = 0.0) -> Limit:
    """Return a limit for the true path until the vehicle rests."""
    return Limit("stop distance", m.stopped_within(late_s), within_m, "m")


def reports(*codes: str, within_s: float, ardupilot: float | None = None) -> Limit:
    """Return a limit for the time until the first STATUSTEXT with one of these codes.

    G7 allows one second after the reaction itself.
    """
    return Limit("reported", statustext_delay(*codes), within_s, "s", ardupilot=ardupilot)


def clear(at_least_m: float) -> Limit:
    """Return a limit for the true clearance in the whole flight."""
    return Limit("clearance", m.clearance, at_least_m, "m", at_least=True)


STREAMS = Limit("setpoint gap", m.longest_gap(), STREAM_GAP_S, "s")
STEADY = Limit("setpoints in a second", m.slowest_second, 20.0, "1/s", at_least=True)
NO_FAILSAFE = Limit("autopilot failsafes", m.failsafes, 0.0, "")
NO_JUMP = Limit("setpoint step", m.setpoint_jump, 0.2, "m")
NO_ORDER = Limit("mode or arm commands", m.commands(), 0.0, "")
COMPLETES = Limit("flights not completed", m.unfinished, 0.0, "")
RETURNS = Limit("flights without a return", m.not_back, 0.0, "")
NEVER_ARMED = Limit("flights armed", m.armed_at_all, 0.0, "")
NO_FORCE = Limit("forced commands", m.forced, 0.0, "")
RETURN_ACTS = Limit("return begun", operator_silence.return_delay, operator_silence.TIMEOUT_S + 1.0, "s")

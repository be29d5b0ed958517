"""Faults of vehicle and autopilot: pushes, motors, battery, transmitter, mode switch."""

from __future__ import annotations

import math

from sitl.faults.injectors.base import TAKEN_OVER, Capabilities, InjectionContext, Injector

HEADING_OFF = "heading off"  # key in notes: time at which the autopilot's heading is off by HEADING_OFF_RAD
HEADING_OFF_RAD = math.radians(10.0)
_TURN_S = 1.0 / 60.0  # of the flight


class Push(Injector):
    """A steady push along the direction of flight for a while, as an acceleration in m/s².

    The accelerometer measures it.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, acceleration_mps2: float, for_s: float) -> None:
        self._force = acceleration_mps2
        self._for_s = for_s
        self._along = (0.0, 0.0)

    def begin(self, at: InjectionContext) -> None:
        """Take the direction of flight."""
        vx, vy, _ = at.world.flyer.truth().velocity
        speed = math.hypot(vx, vy) or 1.0
        self._along = (vx / speed, vy / speed)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Apply the force until for_s."""
        force = self._force if since_s <= self._for_s else 0.0
        at.world.autopilot.vehicle.external_acceleration_mps2 = (self._along[0] * force, self._along[1] * force, 0.0)


class SidewaysForce(Injector):
    """A force that moves the vehicle sideways and keeps it there until it is down.

    y_m: the y coordinate in the world to which it is moved. The force is as strong as needed, up to _MAX_MPS2 per unit of mass.
    """

    needs = Capabilities.SIMULATOR_ACCESS
    _PER_S, _FASTEST_MPS, _STIFF_PER_S, _MAX_MPS2, _DOWN_M = 2.0, 0.8, 25.0, 15.0, 0.2

    def __init__(self, y_m: float) -> None:
        self._y_m = y_m

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Apply the force while the vehicle is in the air."""
        (_, y_m, z_m), (_, vy_mps, _) = (truth := at.world.flyer.truth()).position, truth.velocity
        wanted_mps = min(max(self._PER_S * (self._y_m - y_m), -self._FASTEST_MPS), self._FASTEST_MPS)
        force = min(max(self._STIFF_PER_S * (wanted_mps - vy_mps), -self._MAX_MPS2), self._MAX_MPS2)
        force = force if z_m > self._DOWN_M else 0.0
        at.world.autopilot.vehicle.external_acceleration_mps2 = (0.0, force, 0.0)


class WeakRotors(Injector):
    """Rotors that cannot lift the vehicle: it is three times too heavy."""

    needs = Capabilities.SIMULATOR_ACCESS

    def begin(self, at: InjectionContext) -> None:
        """Weaken the rotors for the rest of the flight."""
        at.world.autopilot.vehicle.set_thrust_ratio(1.0 / 3.0)


class Takeover(Injector):
    """The pilot's mode switch, later_s after the onset.

    modes: the name of the same mode in each firmware.
    """

    needs = Capabilities.RC_TRANSMITTER

    def __init__(self, *modes: str, later_s: float = 0.0) -> None:
        self._modes = modes
        self._later_s = later_s
        self._done = False

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Switch once."""
        if not self._done and since_s >= self._later_s:
            self._done = True
            at.notes[TAKEN_OVER] = at.now_s
            switch(at, self._modes)


class Reboot(Injector):
    """A reboot of the autopilot in the air."""

    needs = Capabilities.SIMULATOR_ACCESS

    def begin(self, at: InjectionContext) -> None:
        """Reboot once."""
        at.world.autopilot.reboot()


class LandDetectorFailed(Injector):
    """A landing that is not detected: a slope, a rug, a failed land detector."""

    needs = Capabilities.SIMULATOR_ACCESS

    def begin(self, at: InjectionContext) -> None:
        """Disable the land detector for the rest of the flight."""
        at.world.autopilot.disable_land_detector()


class VerticalVelocityError(Injector):
    """An estimator whose vertical velocity is off by a constant in the air, as by vibration.

    Its height is right. up_mps: positive if the estimate climbs faster than the vehicle.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, up_mps: float) -> None:
        self._up_mps = up_mps

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Apply the error while the vehicle is in the air."""
        autopilot = at.world.autopilot
        flies = autopilot.truth().armed and not autopilot.vehicle.on_ground
        autopilot.estimator.velocity_error = (0.0, 0.0, -self._up_mps if flies else 0.0)


class HeightDatumMoved(Injector):
    """An estimator whose height jumps, as at a change of its height source.

    It reads up_m higher from then on.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, up_m: float) -> None:
        self._up_m = up_m

    def begin(self, at: InjectionContext) -> None:
        """Move the datum for the rest of the flight."""
        at.world.autopilot.estimator.move_height_datum(self._up_m)


class HeadingError(Injector):
    """An estimator whose heading is off, or turns away by itself, while its position is right.

    It reports the wrong heading and flies by it. offset_deg: at once; rate_degps: more in each second.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, offset_deg: float = 0.0, rate_degps: float = 0.0) -> None:
        self._offset_rad = math.radians(offset_deg)
        self._rate_radps = math.radians(rate_degps)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Apply the error, and note when it passes HEADING_OFF_RAD."""
        error_rad = self._offset_rad + self._rate_radps * since_s
        at.world.autopilot.estimator.heading_error_rad = error_rad
        if abs(error_rad) >= HEADING_OFF_RAD:
            at.notes.setdefault(HEADING_OFF, at.now_s)

    def end(self, at: InjectionContext) -> None:
        """Note the end of a flight that ended before."""
        at.notes.setdefault(HEADING_OFF, at.now_s)


class PropellerTouch(Injector):
    """A propeller that touches a wall: the vehicle tilts and is pushed away.

    Both happen within one turn of the flight. The push is level and across the room, along y of the world, towards its
    middle; the thrust axis tilts the other way.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, tilt_deg: float, acceleration_mps2: float, for_s: float) -> None:
        self._tilt_rad = math.radians(tilt_deg)
        self._change_mps = acceleration_mps2 * for_s
        self._begun_s = math.inf

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Act in the first turn, for as long as a turn takes."""
        self._begun_s = min(self._begun_s, since_s)
        acts = since_s - self._begun_s < 0.5 * _TURN_S
        vehicle = at.world.autopilot.vehicle
        to_middle = (-1.0 if vehicle.position[1] > 0.0 else 1.0) / _TURN_S if acts else 0.0
        vehicle.external_acceleration_mps2 = (0.0, to_middle * self._change_mps, 0.0)
        vehicle.external_turn_rate_radps = (to_middle * self._tilt_rad, 0.0, 0.0)


class TransmitterLost(Injector):
    """Loss of the pilot's transmitter signal."""

    needs = Capabilities.SIMULATOR_ACCESS

    def begin(self, at: InjectionContext) -> None:
        """Disable the signal for the rest of the flight."""
        at.world.autopilot.transmitter(heard=False)


class BatteryDrain(Injector):
    """A charge that falls to a fraction at once, and then by per_s each second."""

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, fraction: float, per_s: float = 0.0) -> None:
        self._fraction = fraction
        self._per_s = per_s

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Set the charge."""
        at.world.autopilot.set_battery(max(self._fraction - self._per_s * since_s, 0.0))


class Parameter(Injector):
    """A parameter of the autopilot with another value than the product requires.

    values: name and value in each firmware.
    """

    needs = Capabilities.SIMULATOR_ACCESS

    def __init__(self, *values: tuple[str, float]) -> None:
        self._values = values

    def begin(self, at: InjectionContext) -> None:
        """Write the parameter.

        Raises KeyError if the firmware has none of these parameters.
        """
        autopilot = at.world.autopilot
        known = [(name, value) for name, value in self._values if name in autopilot.parameters]
        if not known:
            raise KeyError(self._values[0][0])
        autopilot.write_parameter(*known[0])


def switch(at: InjectionContext, modes: tuple[str, ...]) -> None:
    """Select the first of these modes that the firmware has. Raises KeyError for none."""
    for mode in modes:
        try:
            at.world.flyer.pilot_takes_over(mode)
        except KeyError:
            continue
        return
    raise KeyError(modes[0])

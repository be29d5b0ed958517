"""`uav-recon params`: compares the vehicle's parameters with a file, and writes them."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.table import Table

from uav_recon.app import config_file, pilot_factory
from uav_recon.app.option_validation import readable
from uav_recon.autopilot.link.frame_exchange import FrameExchange
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.autopilot.mavlink.tlog import NoLog
from uav_recon.autopilot.mavlink.transport import LinkError, open_link
from uav_recon.autopilot.parameters.parameter_file import ParameterFileError, RequiredParameter, required
from uav_recon.autopilot.parameters.reader import ParameterReader, equal
from uav_recon.clock import MonotonicClock
from uav_recon.config import LinkConfig
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import ByteLink, Clock

T = TypeVar("T")

EXIT_DIFFERENT = 1
EXIT_SILENT = 69
HEARTBEAT_S = 10.0
SAID_S = 1.5
FRESH_S = 3.0
TURN_S = 0.02
WRITE_TRIES = 3  # for one parameter
_HEARTBEAT = 0  # message id
_IN_USE = re.compile("in use|busy", re.IGNORECASE)
_FAMILIES = {3: "ArduPilot", 12: "PX4"}  # MAV_AUTOPILOT
_FAMILY_OF = {"px4": 12, "ardupilot": 3}


@dataclass(frozen=True)
class ParamsOptions:
    """Options of the command line.

    file None: the file of this package. says: the config's link section, which defines the other end. fed: False leaves out the
    parameters of the pose feed. flow: True adds those of optical flow.
    """

    autopilot: str
    link: str
    file: Path | None
    says: LinkConfig = field(default_factory=LinkConfig)
    fed: bool = True
    flow: bool = False

    @staticmethod
    def of(
        autopilot: str | None,
        link: str | None,
        file: Path | None,
        config: Path,
        own_navigation: bool = False,
        flow: bool = False,
    ) -> ParamsOptions:
        """Return the options; missing ones are those of the config, which is read only then.

        Raises UserError.
        """
        if autopilot is not None and autopilot not in _FAMILY_OF:
            raise UserError(f"--autopilot {autopilot}: want one of {', '.join(_FAMILY_OF)}", EXIT_CONFIG)
        if autopilot is not None and link is not None:
            return ParamsOptions(autopilot, link, file, fed=not own_navigation, flow=flow)
        with readable(str(config), EXIT_CONFIG):
            there = config.exists()
        if not there:
            raise UserError(f"give --autopilot and --link, or a --config with both ({config}: no such file)", EXIT_CONFIG)
        loaded = config_file.load_config(config)
        says, fed = loaded.link, loaded.localization.source != "autopilot" and not own_navigation
        flow = flow or loaded.flow.enabled
        return ParamsOptions(autopilot or says.autopilot, link or says.url, file or says.parameters, says, fed, flow)


@dataclass(frozen=True)
class Compared:
    """A parameter with its required and its reported value.

    reported None: the firmware does not know it, or does not answer.
    """

    wanted: RequiredParameter
    reported: ParameterValue | None
    value: float

    @property
    def same(self) -> bool:
        """True if the vehicle has the required value."""
        return equal(self.value, self.wanted.value)


class Vehicle:
    """The vehicle on the other end, on the ground.

    Raises UserError if it does not answer or is another one.
    """

    def __init__(self, bytes_link: ByteLink, options: ParamsOptions, clock: Clock, allow_list: AllowListFilter) -> None:
        self._clock = clock
        self._options = options
        self._firmware, self._form = pilot_factory.firmware(options.autopilot)
        frames = FrameExchange(bytes_link, NoLog(), allow_list.seal)
        self._link = VehicleLink(frames, allow_list, self._firmware, clock.now_s())
        self._await_heartbeat()

    def compare(self, wanted: tuple[RequiredParameter, ...]) -> list[Compared]:
        """Read all parameters back, in their order."""
        inquiry = ParameterReader(one.name for one in wanted)
        while not inquiry.done:
            inquiry.step(self._turn(), self._link)
        if len(inquiry.silent) == len(wanted):
            raise UserError(f"{self._options.link}: the autopilot does not answer parameter requests", EXIT_SILENT)
        return [self._compared(one) for one in wanted]

    def write(self, one: Compared) -> bool:
        """Set a parameter that was reported before. Return True if it reads back.

        Raises UserError while the motors are armed.
        """
        if one.reported is None:
            return False
        try:
            number = self._form.number_of(one.wanted.value, one.reported.kind)
        except ValueError as error:
            raise UserError(f"{one.wanted.name}: {error}, but the vehicle's parameter is an integer", EXIT_CONFIG) from None
        for _ in range(WRITE_TRIES):
            self.need_disarmed()
            self._link.parameters.set(self._clock.now_s(), ParameterValue(one.wanted.name, number, one.reported.kind))
            inquiry = ParameterReader([one.wanted.name])
            while not inquiry.done:
                inquiry.step(self._turn(), self._link)
            if self._compared(one.wanted).same:
                return True
        return False

    def need_disarmed(self) -> None:
        """Wait for the next heartbeat. Raises UserError unless it comes and reports disarmed."""
        asked_s = self._clock.now_s()
        while self._link.telemetry.mode.heartbeat_s <= asked_s:
            if self._turn() - asked_s > FRESH_S:
                raise UserError(f"{self._options.link}: the autopilot stopped answering; writing stopped", EXIT_SILENT)
        if self._link.telemetry.mode.armed:
            raise UserError("the motors are armed: disarm before writing parameters", EXIT_CONFIG)

    def _compared(self, one: RequiredParameter) -> Compared:
        reported = self._link.telemetry.parameters.get(one.name)
        return Compared(one, reported, math.nan if reported is None else self._form.value_of(reported))

    def _await_heartbeat(self) -> None:
        start_s, said = self._clock.now_s(), False
        while self._link.telemetry.system == 0:
            waited_s = self._turn() - start_s
            if waited_s > SAID_S and not said:
                said = True
                print(f"uav-recon: {self._options.link}: waiting for a heartbeat", file=sys.stderr)
            if waited_s > HEARTBEAT_S:
                raise UserError(f"{self._options.link}: no heartbeat from an autopilot within {HEARTBEAT_S:.0f} s", EXIT_SILENT)
        family = self._link.telemetry.mode.firmware_family
        if family != _FAMILY_OF[self._options.autopilot]:
            name = _FAMILIES.get(family, f"MAV_AUTOPILOT {family}")
            raise UserError(
                f"--autopilot (or link.autopilot in the config) is {self._options.autopilot}, but the vehicle runs {name}",
                EXIT_CONFIG,
            )
        self._link.requests.request_streams(self._clock.now_s(), ((_HEARTBEAT, 5.0),))  # each write waits for one

    def _turn(self) -> float:
        """Wait briefly, process received messages, and return the instant."""
        self._link.wait(TURN_S)
        now_s = self._clock.now_s()
        self._link.receive(now_s)
        self._link.requests.poll(now_s)
        if failure := self._link.status.failure:
            raise UserError(f"{self._options.link}: {failure.text()}", EXIT_SILENT)
        return now_s


def check(options: ParamsOptions, every_row: bool) -> int:
    """Print the comparison, all parameters or those that differ; return the exit code."""
    wanted = _wanted(options)
    compared = _on_link(options, lambda vehicle: vehicle.compare(wanted))
    return show(compared, every_row, Console())


def write(options: ParamsOptions, confirm: Callable[[str], bool]) -> int:
    """Write what differs, after confirm() agrees, and read it back; return the exit code."""
    wanted = _wanted(options)
    return _on_link(options, lambda vehicle: write_to(vehicle, wanted, confirm, Console()))


def show(compared: list[Compared], every_row: bool, console: Console) -> int:
    """Print the table and a summary line; return exit code 1 if anything differs."""
    different = [one for one in compared if not one.same]
    shown = compared if every_row else different
    if shown:
        table = Table("", "parameter", "vehicle", "required", "unit", "reason", box=None, pad_edge=False)
        for one in shown:
            name, reason = one.wanted.name, one.wanted.reason
            mark = "" if one.same else "!" if reason.refused else "~"
            has = "no answer" if one.reported is None else f"{one.value:.7g}"
            style = None if one.same else "bold red" if reason.refused else "yellow"
            table.add_row(mark, name, has, f"{one.wanted.value:.7g}", reason.unit, reason.why, style=style)
        console.print(table)
    if not different:
        console.print(f"all {len(compared)} parameters have the required values")
        return 0
    serious = sum(one.wanted.reason.refused for one in different)
    console.print(f"{len(different)} of {len(compared)} parameters differ; {serious} of them (!) block arming")
    return EXIT_DIFFERENT


def write_to(vehicle: Vehicle, wanted: tuple[RequiredParameter, ...], confirm: Callable[[str], bool], console: Console) -> int:
    """Read, ask, write, read back; return exit code 1 if anything differs in the end."""
    compared = vehicle.compare(wanted)
    code = show(compared, False, console)
    if code == 0:
        return 0
    vehicle.need_disarmed()
    to_write = [one for one in compared if not one.same and one.reported is not None]
    if not to_write or not confirm(f"write {len(to_write)} parameters to the vehicle?"):
        console.print("nothing was written")
        return EXIT_DIFFERENT
    for one in to_write:
        done = vehicle.write(one)
        console.print(f"{one.wanted.name} {one.value:.7g} -> {one.wanted.value:.7g}{'' if done else ': NOT accepted'}")
    boot = [one.wanted.name for one in to_write if one.wanted.reason.reboot]
    code = show(vehicle.compare(wanted), False, console)
    console.print(f"reboot the autopilot for these to take effect: {', '.join(boot)}" if boot else "no reboot needed")
    return code


def _wanted(options: ParamsOptions) -> tuple[RequiredParameter, ...]:
    try:
        return required(options.autopilot, options.file, fed=options.fed, flow=options.flow)
    except ParameterFileError as error:
        raise UserError(str(error), EXIT_CONFIG) from None


def _on_link(options: ParamsOptions, work: Callable[[Vehicle], T]) -> T:
    clock = MonotonicClock()
    allow_list = pilot_factory.make_allow_list_filter(options.says, clock)
    try:
        link = open_link(options.link, allow_list, clock, options.says.peer_host)
    except LinkError as error:
        held = " (a running pilot uses this link: stop it first)" if _IN_USE.search(str(error)) else ""
        raise UserError(f"{error}{held}", EXIT_CONFIG) from None
    try:
        return work(Vehicle(link, options, clock, allow_list))
    finally:
        link.close()
        allow_list.close()

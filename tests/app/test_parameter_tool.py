"""`uav-recon params` as a user runs it, against both simulated autopilots.

The link is in memory.
"""

from __future__ import annotations

import io
import random
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import pipe
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.world.quadrotor import Quadrotor
from uav_recon.app.parameter_tool import ParamsOptions, Vehicle, show, write_to
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.parameters.parameter_file import PARAMETER_FILES, RequiredParameter, load
from uav_recon.cli.main import app
from uav_recon.clock import ManualClock
from uav_recon.config import load as load_config
from uav_recon.errors import UserError

FIRMWARES = ["px4", "ardupilot"]
WRONG = {"px4": {"COM_OBL_RC_ACT": 0.0, "SYS_HAS_GPS": 1.0, "MPC_XY_VEL_MAX": 12.0, "COM_FLT_TIME_MAX": 60.0},
         "ardupilot": {"FS_GCS_ENABLE": 0.0, "VISO_TYPE": 0.0, "GUID_TIMEOUT": 3.0}}  # fmt: skip


class Bench:
    """Simulated vehicle on the ground, whose time advances while the tool waits.

    lost: share of its datagrams that is lost.
    """

    def __init__(self, name: str, lost: float = 0.0) -> None:
        self.clock = ManualClock(50.0)
        self._ours, theirs = pipe()
        vehicle = Quadrotor(1, 0.1)
        self.autopilot: Autopilot = (
            Px4(vehicle, theirs, Px4Parameters.load(), 1)
            if name == "px4"
            else ArduCopter(vehicle, theirs, ArduPilotParameters.load(), 1)
        )
        self._lost = lost
        self._luck = random.Random(3)
        self.mute = False
        self.options = ParamsOptions(name, "memory", None)
        self.wanted = load(PARAMETER_FILES[name])

    def read(self) -> bytes:
        data = self._ours.read()
        return b"" if self.mute or self._luck.random() < self._lost else data

    def write(self, data: bytes) -> None:
        self._ours.write(data)

    def wait(self, timeout_s: float) -> None:
        self.clock.advance_to(self.clock.now_s() + timeout_s)
        self.autopilot.step(self.clock.now_s())

    def close(self) -> None:
        self._ours.close()

    def vehicle(self) -> Vehicle:
        return Vehicle(self, self.options, self.clock, AllowListFilter())

    def spoil(self, name: str) -> None:
        for parameter, value in WRONG[name].items():
            self.autopilot.parameters.set(parameter, value)

    def value(self, name: str) -> float:
        return self.autopilot.parameters[name]


class Paper:
    """Captured console output."""

    def __init__(self) -> None:
        self._out = io.StringIO()
        self.console = Console(file=self._out, width=160, highlight=False)

    @property
    def text(self) -> str:
        return self._out.getvalue()

    def row(self, name: str) -> list[str]:
        line = next(line for line in self.text.splitlines() if name in line)
        return line.split()


def yes(question: str) -> bool:
    return True


@pytest.mark.parametrize("name", FIRMWARES)
def test_a_vehicle_with_the_required_parameters_is_equal(name: str) -> None:
    bench, paper = Bench(name), Paper()
    assert show(bench.vehicle().compare(bench.wanted), True, paper.console) == 0
    assert paper.text.splitlines()[-1] == f"all {len(bench.wanted)} parameters have the required values"
    assert len(paper.text.splitlines()) == len(bench.wanted) + 2


@pytest.mark.parametrize("name", FIRMWARES)
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_differing_parameters_are_shown_with_their_reason(name: str, lost: float) -> None:
    bench, paper = Bench(name, lost), Paper()
    bench.spoil(name)
    assert show(bench.vehicle().compare(bench.wanted), False, paper.console) == 1
    for parameter in WRONG[name]:
        assert parameter in paper.text
    assert len(paper.text.splitlines()) == len(WRONG[name]) + 2
    assert f"{len(WRONG[name])} of {len(bench.wanted)} parameters differ; {len(WRONG[name])} of them (!)" in paper.text
    first = {"px4": ["!", "COM_OBL_RC_ACT", "0", "4", "land"], "ardupilot": ["!", "FS_GCS_ENABLE", "0", "5", "land"]}[name]
    assert paper.row(first[1])[:5] == first


@pytest.mark.parametrize("name", FIRMWARES)
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_writing_corrects_the_parameters_and_names_those_that_need_a_reboot(name: str, lost: float) -> None:
    bench, paper = Bench(name, lost), Paper()
    bench.spoil(name)
    assert write_to(bench.vehicle(), bench.wanted, yes, paper.console) == 0
    for one in bench.wanted:
        assert bench.value(one.name) == pytest.approx(one.value), one.name
    assert "NOT accepted" not in paper.text
    boot = {"px4": "SYS_HAS_GPS", "ardupilot": "VISO_TYPE"}[name]
    assert paper.text.splitlines()[-1] == f"reboot the autopilot for these to take effect: {boot}"


def test_nothing_is_written_without_confirmation() -> None:
    bench, paper = Bench("px4"), Paper()
    bench.spoil("px4")
    asked: list[str] = []

    def no(question: str) -> bool:
        asked.append(question)
        return False

    assert write_to(bench.vehicle(), bench.wanted, no, paper.console) == 1
    assert asked == ["write 4 parameters to the vehicle?"]
    assert paper.text.splitlines()[-1] == "nothing was written"
    assert bench.value("COM_OBL_RC_ACT") == 0


def test_without_differences_no_confirmation_is_requested() -> None:
    bench, paper = Bench("px4"), Paper()

    def never(question: str) -> bool:
        raise AssertionError(question)

    assert write_to(bench.vehicle(), bench.wanted, never, paper.console) == 0


def test_nothing_is_written_while_the_motors_are_armed() -> None:
    bench, paper = Bench("ardupilot"), Paper()
    bench.spoil("ardupilot")
    vehicle = bench.vehicle()
    copter = bench.autopilot
    assert isinstance(copter, ArduCopter)
    copter._state.commander.request_arming(arm=True, force=True, c=copter._state.condition())
    assert copter.truth().armed
    with pytest.raises(UserError, match="the motors are armed") as caught:
        write_to(vehicle, bench.wanted, yes, paper.console)
    assert caught.value.code == 78
    assert bench.value("FS_GCS_ENABLE") == 0


def test_a_parameter_unknown_to_the_vehicle_is_reported_and_not_written() -> None:
    bench, paper = Bench("px4"), Paper()
    unknown = RequiredParameter("NOT_OF_THIS_FW", 1.0, bench.wanted[0].reason)
    assert write_to(bench.vehicle(), (*bench.wanted, unknown), yes, paper.console) == 1
    assert paper.row("NOT_OF_THIS_FW")[2:5] == ["no", "answer", "1"]
    assert "nothing was written" in paper.text


def test_a_fraction_is_not_written_to_an_integer_parameter() -> None:
    bench, paper = Bench("px4"), Paper()
    half = RequiredParameter("COM_OBL_RC_ACT", 0.5, bench.wanted[0].reason)
    with pytest.raises(UserError, match=r"COM_OBL_RC_ACT: 0\.5 is not a whole number") as caught:
        write_to(bench.vehicle(), (half,), yes, paper.console)
    assert caught.value.code == 78


def test_silence_and_the_wrong_firmware_are_one_line_errors(capsys: pytest.CaptureFixture[str]) -> None:
    silent = Bench("px4")
    silent.mute = True
    with pytest.raises(UserError, match="no heartbeat from an autopilot within 10 s") as caught:
        silent.vehicle()
    assert caught.value.code == 69
    assert capsys.readouterr().err == "uav-recon: memory: waiting for a heartbeat\n"
    other = Bench("ardupilot")
    other.options = ParamsOptions("px4", "memory", None)
    with pytest.raises(UserError, match=r"link.autopilot in the config\) is px4, but the vehicle runs ArduPilot") as caught:
        other.vehicle()
    assert caught.value.code == 78


def test_writing_stops_when_the_vehicle_falls_silent() -> None:
    bench, paper = Bench("px4"), Paper()
    bench.spoil("px4")
    vehicle = bench.vehicle()

    def unplug(question: str) -> bool:
        bench.mute = True
        return True

    with pytest.raises(UserError, match="stopped answering") as caught:
        write_to(vehicle, bench.wanted, unplug, paper.console)
    assert caught.value.code == 69


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--autopilot", "px5", "--link", "udp:127.0.0.1:1"], "--autopilot px5: want one of px4, ardupilot"),
        (["--autopilot", "px4", "--link", "udp:0.0.0.0:24541"], "name one address"),
        (["--autopilot", "px4", "--link", "nonsense"], "write udp:HOST:PORT or serial:DEVICE:BAUD"),
        (["--autopilot", "px4", "--link", "udp:127.0.0.1:24541", "--file", "none.params"], "none.params: cannot be read"),
        (["--autopilot", "px4", "--config", "none.toml"], "give --autopilot and --link, or a --config"),
    ],
)
def test_invalid_options_are_a_one_line_error_with_exit_code_78(arguments: list[str], words: str) -> None:
    for command in ("check", "diff", "write"):
        ended = CliRunner().invoke(app, ["params", command, *arguments])
        assert ended.exit_code == 78, ended.stderr
        assert words in ended.stderr
        assert len(ended.stderr.splitlines()) == 1


def test_missing_options_are_taken_from_the_config(tmp_path: Path) -> None:
    flown = Path(__file__).parents[2] / "systemd" / "config.toml"
    options = ParamsOptions.of(None, None, None, flown)
    assert options == ParamsOptions("px4", "serial:/dev/fc:921600", None, load_config(flown).link)
    assert ParamsOptions.of("ardupilot", "udp:127.0.0.1:14540", None, tmp_path / "none") == ParamsOptions(
        "ardupilot", "udp:127.0.0.1:14540", None
    )
    assert ParamsOptions.of("px4", "udp:127.0.0.1:14540", None, tmp_path / "none", flow=True).flow
    with_flow = tmp_path / "config.toml"
    with_flow.write_text(flown.read_text().replace("# enabled = true", "enabled = true"))
    assert ParamsOptions.of(None, None, None, with_flow).flow
    assert not options.flow

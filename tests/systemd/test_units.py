from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from uav_recon import config
from uav_recon.app.process_table import NO_RESTART_EXIT_CODES, SERVICES, STOP_ORDER, ServiceProcess

FOLDER = Path(__file__).parents[2] / "systemd"
NAMES = [service.name for service in SERVICES]


def _options(service: str) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for line in (FOLDER / f"uav-recon-{service}.service").read_text().splitlines():
        if "=" in line and not line.startswith("#"):
            key, value = line.split("=", 1)
            out.setdefault(key, []).append(value)
    return out


def _seconds(values: list[str]) -> float:
    """Return the only value of a key in seconds: `200ms`, or seconds without a unit."""
    (value,) = values
    return float(value.removesuffix("ms")) / 1000.0 if value.endswith("ms") else float(value)


@pytest.fixture
def installed(tmp_path: Path) -> list[Path]:
    """Return copies of the units with an existing executable, for systemd-analyze."""
    units = []
    for unit in [*FOLDER.glob("*.service"), *FOLDER.glob("*.target")]:
        text = unit.read_text().replace("/opt/uav_recon/bin/uav-recon", shutil.which("true") or "/bin/true")
        (tmp_path / unit.name).write_text(text)
        units.append(tmp_path / unit.name)
    return units


def _analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    tool = shutil.which("systemd-analyze")
    assert tool, "systemd-analyze is missing: install the package 'systemd'"
    return subprocess.run([tool, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_units_are_clean(installed: list[Path]) -> None:
    assert len(installed) == 4
    answer = _analyze("verify", "--man=no", "--recursive-errors=yes", *map(str, installed))
    assert (answer.returncode, answer.stdout + answer.stderr) == (0, "")


def test_a_fault_in_a_unit_is_detected(installed: list[Path]) -> None:
    """Negative control of the check above."""
    unit = next(unit for unit in installed if "pilot" in unit.name)
    unit.write_text(unit.read_text().replace("WatchdogSec=", "WatchdogSecs="))
    assert "WatchdogSecs" in _analyze("verify", "--man=no", str(unit)).stderr


@pytest.mark.parametrize(("service", "limit"), [("pilot", 25), ("perception", 50), ("mission", 50)])
def test_exposure_is_bounded(installed: list[Path], service: str, limit: int) -> None:
    unit = next(unit for unit in installed if service in unit.name)
    answer = _analyze("security", "--offline=true", f"--threshold={limit}", str(unit))
    assert answer.returncode == 0, answer.stdout[-300:]


@pytest.mark.parametrize("service", SERVICES, ids=NAMES)
def test_each_unit_repeats_its_row_of_the_process_table(service: ServiceProcess) -> None:
    options = _options(service.name)
    arguments = " ".join(service.arguments(Path("/etc/uav_recon/config.toml")))
    assert options["ExecStart"] == [f"/opt/uav_recon/bin/uav-recon {arguments}"]
    assert options["Restart"] == [service.restart.value]
    assert _seconds(options["RestartSec"]) == service.restart_delay_s
    assert options["RestartPreventExitStatus"] == [" ".join(map(str, sorted(NO_RESTART_EXIT_CODES)))]
    assert _seconds(options["WatchdogSec"]) == service.watchdog_s
    assert _seconds(options["TimeoutStopSec"]) == service.stop_timeout_s
    if service.fifo_priority is None:
        assert options["Nice"] == [str(service.niceness)]
        assert not {"CPUSchedulingPolicy", "CPUSchedulingPriority"} & set(options)
    else:
        assert options["CPUSchedulingPolicy"] == ["fifo"]
        assert options["CPUSchedulingPriority"] == [str(service.fifo_priority)]
        assert "Nice" not in options  # it has no effect beside a real-time priority


def test_the_process_table_has_each_unit_in_the_order_of_the_target() -> None:
    units = [f"uav-recon-{name}.service" for name in NAMES]
    target = configparser.ConfigParser(interpolation=None)
    target.optionxform = str  # type: ignore[assignment,method-assign]
    target.read(FOLDER / "uav-recon.target")
    assert target["Unit"]["Wants"].split() == units
    assert sorted(path.name for path in FOLDER.glob("*.service")) == sorted(units)
    assert set(STOP_ORDER) == set(SERVICES)


@pytest.mark.parametrize("service", NAMES)
def test_each_service_notifies_and_shares_the_runtime_folder(service: str) -> None:
    options = _options(service)
    assert options["Type"] == ["notify"]
    assert options["RuntimeDirectory"] == ["uav_recon"]
    assert float(options["WatchdogSec"][0]) <= {"pilot": 1, "perception": 3, "mission": 5}[service]


def test_the_pilot_is_always_restarted_and_has_no_memory_limit() -> None:
    options = _options("pilot")
    assert options["Restart"] == ["always"]
    assert options["StartLimitIntervalSec"] == ["0"]
    assert float(options["RestartSec"][0].removesuffix("ms")) <= 200
    assert "MemoryMax" not in options
    assert "RestrictRealtime" not in options  # it needs SCHED_FIFO
    assert options["LimitMEMLOCK"] == ["infinity"]  # with any other limit memory_lock.py does not lock


def test_perception_and_mission_are_restarted_three_times() -> None:
    for service in ("perception", "mission"):
        options = _options(service)
        assert options["StartLimitBurst"] == ["4"]  # the first start and three more
        assert any("NUMBA_CACHE_DIR" in value and "NUMBA_THREADING_LAYER" in value for value in options["Environment"])


def test_no_service_stops_with_another() -> None:
    for service in NAMES:
        assert not {"Requires", "BindsTo", "Requisite"} & set(_options(service))


def test_no_service_waits_for_another_at_boot() -> None:
    """A waiting pilot could not report what is missing.

    Perception is READY only once camera and poses are available.
    """
    for service in NAMES:
        options = _options(service)
        assert options["After"] == ["local-fs.target"]
        assert not {"Wants", "Before", "Upholds"} & set(options)


def test_the_stop_of_perception_may_be_extended_until_the_pilot_has_landed() -> None:
    """A stop of the target stops both services at once.

    run_perception() continues meanwhile, and its main process extends the timeout of systemd.
    """
    options = _options("perception")
    assert options["NotifyAccess"] == ["main"]
    assert options["KillMode"] == ["mixed"]
    assert "RuntimeMaxSec" not in options
    assert float(options["TimeoutStopSec"][0]) < float(_options("pilot")["TimeoutStopSec"][0])  # librealsense may hang


def test_out_of_memory_kills_one_process_of_the_mission_and_not_all() -> None:
    assert _options("mission")["OOMPolicy"] == ["continue"]


def test_comments_do_not_share_a_line_with_a_value() -> None:
    """systemd would read such a comment as part of the value."""
    for unit in FOLDER.glob("*.service"):
        assert not re.search(r"^[A-Za-z]+=.*[ \t]#", unit.read_text(), flags=re.MULTILINE)
        parser = configparser.ConfigParser(strict=False, interpolation=None)
        parser.optionxform = str  # type: ignore[assignment,method-assign]
        parser.read(unit)
        assert parser.sections() == ["Unit", "Service", "Install"]


def test_the_flown_config_loads_and_explains_every_protective_number() -> None:
    path = FOLDER / "config.toml"
    flown = config.load(path)
    assert not flown.mission.autostart
    text = path.read_text()
    for name in config.SafetyConfig.model_fields:
        line = next(line for line in text.splitlines() if line.startswith(f"{name} ="))
        assert "#" in line, f"{name} wants its reason beside it"


def test_installation_names_every_unit_and_group() -> None:
    text = (FOLDER / "README.md").read_text()
    for unit in [*FOLDER.glob("*.service"), *FOLDER.glob("*.target")]:
        assert f"`{unit.name}`" in text
    for service in NAMES:
        for group in _options(service).get("SupplementaryGroups", [""])[0].split():
            assert group in text


def test_cpu_and_memory_priority_fall_from_pilot_to_perception_to_mission() -> None:
    """Each service is a separate control group, and nice values do not count between groups."""
    weights = [int(_options(service)["CPUWeight"][0]) for service in NAMES]
    assert weights == sorted(weights, reverse=True)
    assert weights[1] >= 10 * weights[2]
    scores = [int(_options(service)["OOMScoreAdjust"][0]) for service in NAMES]
    assert scores == sorted(scores)


@pytest.mark.parametrize("service", NAMES)
def test_each_service_has_its_limits(service: str) -> None:
    options = _options(service)
    assert int(options["TasksMax"][0]) <= 512
    assert service == "pilot" or "MemoryMax" in options
    assert float(options["TimeoutStopSec"][0]) >= {"pilot": 60, "perception": 5, "mission": 300}[service]


def test_an_operator_of_the_group_reaches_the_pilots_socket() -> None:
    """The socket is in the runtime directory, which the group may enter.

    The pilot must see the real user ids (SO_PEERCRED).
    """
    options = _options("pilot")
    runtime = config.load(FOLDER / "config.toml").runtime
    assert str(runtime.folder / runtime.operator) == f"/run/{options['RuntimeDirectory'][0]}/operator.socket"
    assert int(options["RuntimeDirectoryMode"][0], 8) & 0o050 == 0o050
    assert options.get("PrivateUsers", ["no"]) == ["no"]
    assert any("AF_UNIX" in value for value in options["RestrictAddressFamilies"])
    assert options["Group"] == ["uav"]

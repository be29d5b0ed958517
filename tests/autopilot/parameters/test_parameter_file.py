"""The files of parameters and the README that gives each its reason."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.px4.parameters import Px4Parameters
from uav_recon.autopilot.parameters.parameter_file import (
    FLOW_FILES,
    FLOW_REASONS,
    FOLDER,
    PARAMETER_FILES,
    REASONS,
    ParameterFileError,
    load,
    load_reasons,
    required,
)

RETURNS = {  # what an action must never be, of each firmware: Return, and on PX4 Hold, which needs a global position
    "NAV_RCL_ACT": {2}, "NAV_DLL_ACT": {2}, "COM_OBL_RC_ACT": {3, 5}, "COM_LOW_BAT_ACT": {1, 3}, "GF_ACTION": {2, 3},
    "FS_THR_ENABLE": {1, 4, 5}, "FS_GCS_ENABLE": {1, 3, 4}, "FENCE_ACTION": {1, 3}, "FS_DR_ENABLE": {2, 3, 4},
    "BATT_FS_LOW_ACT": {2, 3, 4}, "BATT_FS_CRT_ACT": {2, 3, 4},
}  # fmt: skip


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", PARAMETER_FILES.values(), ids=lambda p: p.name)
def test_each_value_has_its_row_and_each_row_its_value(path: Path) -> None:
    section = next(part for part in REASONS.read_text().split("\n## ") if f"`{path.name}`" in part)
    told = {
        name: (value, default)
        for name, value, default in re.findall(r"^\| ([A-Z0-9_]+) \| ([^ |]+) \| ([^ |]+) \|", section, re.MULTILINE)
    }
    wanted = {one.name: one for one in load(path)}
    assert set(told) == set(wanted)
    for name, (value, _) in told.items():
        assert float(value) == wanted[name].value, name
        assert wanted[name].reason.why, name
    simulated = {**_defaults(Px4Parameters()), **_defaults(ArduPilotParameters())}
    assert {name: float(default) for name, (_, default) in told.items()} == {name: simulated[name] for name in told}


def _defaults(table: Px4Parameters | ArduPilotParameters) -> dict[str, float]:
    return {name: table[name] for name in table}


def test_no_action_is_a_return_and_each_is_met_before_arming() -> None:
    for one in (*load(PARAMETER_FILES["px4"]), *load(PARAMETER_FILES["ardupilot"])):
        if one.name in RETURNS:
            assert one.value not in RETURNS[one.name], one.name
            assert one.reason.refused, one.name


def test_every_reason_has_its_words() -> None:
    reasons = load_reasons()
    assert len(reasons) == sum(len(load(path)) for path in PARAMETER_FILES.values())
    assert reasons["VISO_TYPE"].reboot
    assert not reasons["COM_OF_LOSS_T"].reboot
    assert reasons["COM_OF_LOSS_T"].unit == "s"
    assert reasons["GF_ACTION"].unit == ""


def test_the_files_travel_with_the_package() -> None:
    data = (FOLDER.parent / "pyproject.toml").read_text()
    packaged = re.search(r"^firmware_params = \[(.*)\]", data, re.MULTILINE)
    assert packaged
    for path in FOLDER.iterdir():
        assert f'"*{path.suffix}"' in packaged.group(1), path.name


def test_both_formats_are_read(tmp_path: Path) -> None:
    qgc = written(tmp_path, "a.params", "# head\n1\t1\tCOM_OBL_RC_ACT\t4\t6\n\n1\t1\tMINE_TOO\t0.5\t9\n")
    planner = written(tmp_path, "b.param", "#NOTE: head\nVISO_TYPE,1\nMINE_TOO, 0.5\n")
    assert [(one.name, one.value, one.reason.refused) for one in load(qgc)] == [
        ("COM_OBL_RC_ACT", 4.0, True), ("MINE_TOO", 0.5, True),
    ]  # fmt: skip
    assert [(one.name, one.value) for one in load(planner)] == [("VISO_TYPE", 1.0), ("MINE_TOO", 0.5)]


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("a.txt", "VISO_TYPE,1\n", "ends in .params"),
        ("a.params", "# head\nCOM_OBL_RC_ACT 4\n", "a.params:2: expected five fields"),
        ("a.params", "1\t1\tCOM_OBL_RC_ACT\t4.5\t6\n", "a.params:1: COM_OBL_RC_ACT is to be an integer, not '4.5'"),
        ("a.params", "1\t1\tCOM_OBL_RC_ACT\t4\t99\n", "has type '99'"),
        ("a.param", "VISO_TYPE 1\n", "a.param:1: expected a name and a value"),
        ("a.param", "VISO_TYPE,one\n", "VISO_TYPE is to be a number, not 'one'"),
        ("a.param", "VISO_TYPE,nan\n", "VISO_TYPE is to be a finite number"),
        ("a.param", "VISO_TYPE,1\nVISO_TYPE,0\n", "a.param:2: VISO_TYPE stands here twice"),
        ("a.param", "viso type,1\n", "'viso type' is no name"),
        ("a.param", "MUCH_TOO_LONG_A_NAME,1\n", "is no name"),
        ("a.param", "# nothing\n", "no parameter stands in it"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path: Path, name: str, text: str, fault: str) -> None:
    with pytest.raises(ParameterFileError) as caught:
        load(written(tmp_path, name, text))
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match="cannot be read"):
        load(tmp_path / "none.param")
    (tmp_path / "x.param").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterFileError, match="not text"):
        load(tmp_path / "x.param")


def test_a_row_that_is_short_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match=r"R\.md:1: a row is parameter"):
        load_reasons(written(tmp_path, "R.md", "| A_B | 1 | 0 | s | why | who | maybe | - |\n"))


def test_no_line_is_longer_than_ardupilots_own_reader_takes() -> None:
    """What is over becomes a line of its own there, and its first word a parameter."""
    lines = PARAMETER_FILES["ardupilot"].read_text(encoding="ascii").splitlines(keepends=True)
    assert max(map(len, lines)) <= 98


@pytest.mark.parametrize("path", PARAMETER_FILES.values(), ids=lambda p: p.name)
def test_an_autopilot_that_navigates_by_itself_keeps_the_parameters_of_its_navigation(path: Path) -> None:
    every, own = {one.name for one in load(path)}, {one.name for one in load(path, fed=False)}
    left_out = every - own
    assert left_out >= {"EKF2_EV_CTRL", "EKF2_EV_DELAY", "EKF2_EV_POS_X"} or left_out >= {"EK3_SRC1_POSXY", "VISO_TYPE"}
    assert not left_out & {"EKF2_GPS_CTRL", "GPS1_TYPE", "COM_OBL_RC_ACT", "FS_GCS_ENABLE", "MPC_XY_VEL_MAX", "WP_SPD"}


@pytest.mark.parametrize("name", FLOW_FILES)
def test_each_value_of_optical_flow_has_its_row_and_each_row_its_value(name: str) -> None:
    path = FLOW_FILES[name]
    section = next(
        part for part in FLOW_REASONS.read_text().split("\n## ") if f"`{path.name}`" in part and "| arming |" in part
    )
    told = dict(re.findall(r"^\| ([A-Z0-9_]+) \| ([^ |]+) \|", section, re.MULTILINE))
    wanted = {one.name: one for one in load(path, reasons_path=FLOW_REASONS)}
    assert {one: float(value) for one, value in told.items()} == {one.name: one.value for one in wanted.values()}
    assert all(one.reason.why for one in wanted.values())
    assert max(map(len, path.read_text(encoding="ascii").splitlines(keepends=True))) <= 98 or path.suffix == ".params"


@pytest.mark.parametrize(
    ("name", "replaced", "added"),
    [
        ("px4", {"EKF2_OF_CTRL": 1.0, "EKF2_RNG_CTRL": 1.0}, "SENS_FLOW_RATE"),
        ("ardupilot", {"EK3_SRC_OPTIONS": 1.0}, "EK3_SRC2_VELXY"),
    ],
)
def test_optical_flow_replaces_some_parameters_and_adds_others(name: str, replaced: dict[str, float], added: str) -> None:
    without, with_flow = ({one.name: one for one in required(name, flow=flow)} for flow in (False, True))
    assert list(without) == [one.name for one in load(PARAMETER_FILES[name])]
    for parameter, value in replaced.items():
        assert without[parameter].value == 0.0
        assert with_flow[parameter].value == value
        assert with_flow[parameter].reason.refused
    assert added in set(with_flow) - set(without)
    assert {one: with_flow[one].value for one in without if one not in replaced} == {
        one: without[one].value for one in without if one not in replaced
    }
    own = {one.name for one in required(name, fed=False, flow=True)}
    assert own == {one.name for one in required(name, fed=False)}, "it keeps its own navigation"


def test_optical_flow_is_added_to_a_users_own_file(tmp_path: Path) -> None:
    own = written(tmp_path, "own.param", "EK3_SRC_OPTIONS,0\nMINE_TOO,0.5\n")
    values = {one.name: one.value for one in required("ardupilot", own, flow=True)}
    assert values["MINE_TOO"] == 0.5
    assert values["EK3_SRC_OPTIONS"] == 1.0
    assert values["EK3_SRC2_VELXY"] == 5.0

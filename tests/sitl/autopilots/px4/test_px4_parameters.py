from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

from sitl.autopilots.px4.parameters import DEFAULT_FILE, INT32, REAL32, ParameterError, Px4Parameters


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "some.params"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_indoor_file_loads_and_sets_no_failsafe_to_return() -> None:
    p = Px4Parameters.load()
    assert p.integer("COM_OBL_RC_ACT") == 4
    assert p.integer("NAV_RCL_ACT") == 3
    assert p.integer("COM_LOW_BAT_ACT") == 2
    assert p.integer("GF_ACTION") == 5
    assert p.integer("COM_FLT_TIME_MAX") == -1
    assert p["COM_OF_LOSS_T"] == 0.5
    assert p.integer("EKF2_NOAID_TOUT") == 3_000_000


def test_the_indoor_readme_explains_each_value_of_the_file() -> None:
    section = DEFAULT_FILE.with_name("README.md").read_text().split("\n## ")[1]
    told = dict(re.findall(r"^\| ([A-Z0-9_]+) \| ([^ |]+) \|", section, re.MULTILINE))
    told.pop("parameter", None)
    rows = [line.split("\t") for line in DEFAULT_FILE.read_text().splitlines() if line and not line.startswith("#")]
    assert told == {name: value for _, _, name, value, _ in rows}


def test_without_a_file_the_defaults_apply() -> None:
    p = Px4Parameters()
    assert p["COM_OF_LOSS_T"] == 1.0
    assert p.integer("COM_OBL_RC_ACT") == 0


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("1\t1\tNO_SUCH_NAME\t1\t6", "unknown parameter NO_SUCH_NAME"),
        ("1\t1\tCOM_OBL_RC_ACT\t4\t9", "has type 6"),
        ("1\t1\tCOM_OF_LOSS_T\tfast\t9", "could not convert"),
        ("1\t1\tCOM_OF_LOSS_T\tnan\t9", "finite"),
        ("1\t1\tCOM_OBL_RC_ACT\t4.5\t6", "invalid literal"),
        ("COM_OBL_RC_ACT 4", "five fields"),
    ],
)
def test_a_bad_line_names_file_line_and_fault(tmp_path: Path, line: str, fault: str) -> None:
    path = written(tmp_path, f"# header\n{line}\n")
    with pytest.raises(ParameterError, match=re.escape(f"{path}:2: ")) as caught:
        Px4Parameters.load(path)
    assert fault in str(caught.value)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cannot be read"):
        Px4Parameters.load(tmp_path / "none.params")


@pytest.mark.parametrize("value", [-1, 0, 4, 121212, 2**31 - 1, -(2**31)])
def test_integers_are_sent_bytewise(value: int) -> None:
    p = Px4Parameters()
    p.set("CBRK_FLIGHTTERM", value)
    wire = struct.unpack("<f", struct.pack("<f", p.on_wire("CBRK_FLIGHTTERM")))[0]
    assert p.from_wire("CBRK_FLIGHTTERM", wire) == value
    if value == 4:
        assert wire != pytest.approx(4.0)


def test_types_indices_and_revision() -> None:
    p = Px4Parameters()
    assert p.kind("COM_OBL_RC_ACT") == INT32
    assert p.kind("COM_OF_LOSS_T") == REAL32
    assert [p.name(p.index(name)) for name in p] == list(p)
    assert list(p) == sorted(p)
    before = p.revision
    p.set("COM_OF_LOSS_T", 0.7)
    assert p.revision == before + 1
    assert p["COM_OF_LOSS_T"] == pytest.approx(0.7)
    with pytest.raises(ValueError, match="not an integer"):
        p.integer("COM_OF_LOSS_T")
    with pytest.raises(IndexError):
        p.name(-1)
    with pytest.raises(ValueError, match="32-bit"):
        p.set("COM_OBL_RC_ACT", 2.5)

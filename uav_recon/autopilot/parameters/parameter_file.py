"""Required parameters of a vehicle: a file in its ground station's format.

The README of the folder gives a reason for each.

`.params` is QGroundControl's (vehicle, component, name, value and MAV_PARAM_TYPE between tabs), `.param` Mission Planner's
(name and value with a comma between them).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[3] / "firmware_params"
REASONS = FOLDER / "README.md"
FLOW_REASONS = FOLDER / "flow.md"
FLOW_FILES = {"px4": FOLDER / "px4_flow.params", "ardupilot": FOLDER / "ardupilot_flow.param"}
PARAMETER_FILES = {"px4": FOLDER / "px4_indoor.params", "ardupilot": FOLDER / "ardupilot_indoor.param"}
_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
_REAL32 = 9
_INTEGERS = range(1, 7)  # MAV_PARAM_TYPE
_POSE_FEED = ("pose feed", "pose feed, map", "pose jump gate")
_COLUMNS = ("parameter", "value", "default", "unit", "why", "who relies on it", "arming", "a change needs")


class ParameterFileError(Exception):
    """A file that cannot be used; its text is one line that names file, line and fault."""


@dataclass(frozen=True, slots=True)
class ParameterReason:
    """An entry of the README's table.

    refused: arming is refused while the vehicle has another value. reboot: a change needs one. fed: only a vehicle that is fed
    the companion's poses needs it.
    """

    value: str
    unit: str
    why: str
    refused: bool
    reboot: bool
    fed: bool = False


@dataclass(frozen=True, slots=True)
class RequiredParameter:
    """A parameter and its required value."""

    name: str
    value: float
    reason: ParameterReason


def required(
    autopilot: str, path: Path | None = None, *, fed: bool = True, flow: bool = False
) -> tuple[RequiredParameter, ...]:
    """Return every parameter that a vehicle needs. Raises ParameterFileError.

    autopilot: px4 or ardupilot. path: the user's own file, in place of the one for the autopilot. fed: as of load(). flow: also
    those of optical flow, which replace others of the same name; not for an autopilot that navigates by itself.
    """
    wanted = {one.name: one for one in load(path or PARAMETER_FILES[autopilot], fed=fed)}
    if flow and fed:
        wanted |= {one.name: one for one in load(FLOW_FILES[autopilot], reasons_path=FLOW_REASONS)}
    return tuple(wanted.values())


def load(path: Path, *, fed: bool = True, reasons_path: Path = REASONS) -> tuple[RequiredParameter, ...]:
    """Return every parameter of a file, in its order. Raises ParameterFileError.

    fed: False leaves out those of the pose feed, for an autopilot that navigates by itself. reasons_path: README with an entry
    for each. A name without one is user-defined: it must be met before arming too.
    """
    read_line = {".params": _qgroundcontrol, ".param": _mission_planner}.get(path.suffix)
    if read_line is None:
        raise ParameterFileError(f"{path}: a parameter file ends in .params (QGroundControl) or .param (Mission Planner)")
    values = _values(path, read_line)
    reasons, own = load_reasons(reasons_path), ParameterReason("", "", "", refused=True, reboot=False)
    wanted = (RequiredParameter(name, value, reasons.get(name, own)) for name, value in values.items())
    return tuple(one for one in wanted if fed or not one.reason.fed)


def load_reasons(path: Path = REASONS) -> dict[str, ParameterReason]:
    """Return the entries of the README by name. Raises ParameterFileError."""
    rows: dict[str, ParameterReason] = {}
    for number, line in enumerate(_lines(path), start=1):
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|") or cells[0] == _COLUMNS[0] or set(cells[0]) <= set("-: "):
            continue
        if len(cells) != len(_COLUMNS) or cells[6] not in ("refused", "-") or cells[7] not in ("reboot", "-"):
            raise ParameterFileError(f"{path}:{number}: a row is {' | '.join(_COLUMNS)}")
        name, value, _, unit, why, relies, arming, change = cells
        refused, reboot, fed = arming == "refused", change == "reboot", relies in _POSE_FEED
        rows[name] = ParameterReason(value, unit.strip("-"), why, refused, reboot, fed)
    return rows


def _values(path: Path, read_line: Callable[[str], tuple[str, float]]) -> dict[str, float]:
    values: dict[str, float] = {}
    for number, line in enumerate(_lines(path), start=1):
        if line.startswith("#") or not line.strip():
            continue
        try:
            name, value = read_line(line)
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a parameter")
            if name in values:
                raise ValueError(f"{name} stands here twice")
            if not math.isfinite(value):
                raise ValueError(f"{name} is to be a finite number, not {value}")
        except ValueError as error:
            raise ParameterFileError(f"{path}:{number}: {error}") from None
        values[name] = value
    if not values:
        raise ParameterFileError(f"{path}: no parameter stands in it")
    return values


def _qgroundcontrol(line: str) -> tuple[str, float]:
    fields = line.split("\t")
    if len(fields) != 5:
        raise ValueError(f"expected five fields with tabs between them, got {len(fields)}")
    _, _, name, value, kind = (field.strip() for field in fields)
    if kind != str(_REAL32) and kind not in map(str, _INTEGERS):
        raise ValueError(f"{name} has type {kind!r}, want 1 to 6 for an integer or 9 for a float")
    return name, _number(name, value, whole=kind != str(_REAL32))


def _mission_planner(line: str) -> tuple[str, float]:
    name, comma, value = line.partition(",")
    if not comma:
        raise ValueError("expected a name and a value with a comma between them")
    return name.strip(), _number(name, value, whole=False)


def _number(name: str, text: str, whole: bool) -> float:
    try:
        return float(int(text)) if whole else float(text)
    except ValueError:
        raise ValueError(f"{name} is to be {'an integer' if whole else 'a number'}, not {text.strip()!r}") from None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ParameterFileError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ParameterFileError(f"{path}: not text") from None

"""The script on the card of an ArduCopter, run by a Lua of its version: silence in GUIDED is landed for, once."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from lupa.lua53 import LuaRuntime

from uav_recon.autopilot.parameters.parameter_file import FOLDER, PARAMETER_FILES, load

GUIDED, LOITER, LAND = 4, 5, 9
# What ArduPilot gives its scripts, as far as this one asks: uint32_t is a type of its own there, and no number.
BINDINGS = """
local u32 = {}
u32.__index = u32
function uint32_t(n) return setmetatable({n = n & 0xffffffff}, u32) end
u32.__sub = function(a, b) return uint32_t(a.n - b.n) end
u32.__lt = function(a, b) return a.n < b.n end
function u32:tofloat() return self.n + 0.0 end
function millis() return uint32_t(board.now_ms) end
gcs = {last_seen = function() return uint32_t(board.heard_ms) end, send_text = function(_, severity, text) board.said(text) end}
arming = {is_armed = function() return board.armed end}
vehicle = {get_mode = function() return board.mode end, set_mode = function(_, mode) return board.set_mode(mode) end}
param = {
  add_table = function(_, key, prefix, count) board.prefix = prefix; return board.has_room end,
  add_param = function(_, key, n, name, value)
    return board.has_name and board.add_param(board.prefix .. name, value)
  end,
}
function Parameter(name)
  return {get = function() return board.value(name) end, set = function(_, value) return board.add_param(name, value) end}
end
"""


@dataclass
class Board:
    """An autopilot as the script sees it."""

    now_ms: int = 100_000
    heard_ms: int = 100_000
    armed: bool = True
    mode: int = GUIDED
    has_room: bool = True
    has_name: bool = True
    refuses: bool = False
    prefix: str = ""
    parameters: dict[str, float] = field(default_factory=lambda: {"FS_GCS_ENABLE": 5.0})
    texts: list[str] = field(default_factory=list)
    orders: list[int] = field(default_factory=list)

    def boot(self) -> None:
        lua = LuaRuntime()
        lua.globals().board = self
        lua.execute(BINDINGS)
        self._watch = lua.execute((FOLDER / "ardupilot_silence.lua").read_text(encoding="ascii"))[0]

    def run(self, for_s: float, heard: bool) -> None:
        for _ in range(round(for_s * 20)):
            self.now_ms += 50
            if heard:
                self.heard_ms = self.now_ms & 0xFFFFFFFF
            self._watch, every_ms = self._watch()
            assert every_ms == 50

    def set_mode(self, mode: int) -> bool:
        self.orders.append(mode)
        self.mode = self.mode if self.refuses else mode
        return not self.refuses

    def said(self, text: str) -> None:
        self.texts.append(text)

    def add_param(self, name: str, value: float) -> bool:
        self.parameters[name] = value
        return True

    def value(self, name: str) -> float:
        return self.parameters[name]


def board(**given: object) -> Board:
    one = Board(**given)  # type: ignore[arg-type]
    one.boot()
    return one


def test_it_lands_once_when_the_companion_has_been_silent_for_so_long() -> None:
    b = board()
    b.run(5.0, heard=True)
    b.run(1.5, heard=False)
    assert b.orders == []
    b.run(0.1, heard=False)
    assert b.orders == [LAND]
    b.run(5.0, heard=False)
    assert b.orders == [LAND]
    assert b.texts == ["Companion silent: landing"]
    assert b.parameters["FS_GCS_ENABLE"] == 0.0, "it would begin its wait anew"
    b.armed = False
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 5.0
    b.parameters["FS_GCS_ENABLE"] = 1.0  # somebody's own, on the floor
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 1.0


def test_what_it_gives_back_is_what_it_took_first() -> None:
    b = board()
    b.run(2.0, heard=False)
    b.mode = GUIDED  # taken out of the landing, and silent still
    b.run(0.1, heard=False)
    assert b.orders == [LAND, LAND]
    b.armed = False
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 5.0


@pytest.mark.parametrize("given", [{"armed": False}, {"mode": LOITER}, {"mode": LAND}, {"heard_ms": 0}])
def test_else_it_does_nothing(given: dict[str, object]) -> None:
    """On the floor, in a pilot's hands, landing already, with a companion that never was."""
    b = board(**given)
    b.run(5.0, heard=False)
    assert b.orders == []
    assert b.texts == []


def test_a_landing_that_is_refused_is_asked_for_again() -> None:
    b = board(refuses=True)
    b.run(2.0, heard=False)
    assert len(b.orders) > 3
    assert b.texts == []
    assert b.parameters["FS_GCS_ENABLE"] == 5.0, "the firmware's own failsafe stays behind it"
    b.refuses = False
    b.run(1.0, heard=False)
    assert b.mode == LAND


def test_a_clock_that_wraps_is_no_silence() -> None:
    b = board(now_ms=0xFFFFFFFF - 1000, heard_ms=0xFFFFFFFF - 1000)
    b.run(3.0, heard=True)
    assert b.orders == []


def test_its_parameter_is_the_one_that_is_read_before_arming() -> None:
    b = board()
    wanted = {one.name: one for one in load(PARAMETER_FILES["ardupilot"])}
    assert b.parameters["UVR_SILENCE_S"] == wanted["UVR_SILENCE_S"].value
    assert wanted["UVR_SILENCE_S"].reason.refused
    assert wanted["SCR_ENABLE"].reason.refused
    b.parameters["UVR_SILENCE_S"] = 3.0
    b.run(2.0, heard=False)
    assert b.orders == []


@pytest.mark.parametrize(("lacks", "says"), [("has_room", "no parameter table"), ("has_name", "no parameter(?! table)")])
def test_without_room_for_its_parameter_it_does_not_run(lacks: str, says: str) -> None:
    with pytest.raises(Exception, match=says):
        board(**{lacks: False})

"""The script on the card of an ArduCopter, run by a Lua of its version: silence in GUIDED is landed for, once."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import pytest
from lupa.lua53 import LuaRuntime

from uav_recon.autopilot.mavlink.address import COMPANION_ADDRESS
from uav_recon.autopilot.mavlink.codec import Decoder, Encoder
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
gcs = {send_text = function(_, severity, text) board.said(text) end}
mavlink = {
  init = function(_, queue, kinds) assert(queue <= 25 and kinds == 1) end,
  register_rx_msgid = function(_, kind) board.kind = kind end,
  receive_chan = function(_)
    local message = board.receive()
    if message then return message, 0, millis() end
  end,
}
arming = {is_armed = function() return board.armed end}
vehicle = {get_mode = function() return board.mode end, set_mode = function(_, mode) return board.set_mode(mode) end}
param = {
  add_table = function(_, key, prefix, count) board.prefix = prefix; return board.has_room end,
  add_param = function(_, key, n, name, value)
    return board.has_name and board.add_param(board.prefix .. name, value)
  end,
}
function Parameter(name)
  local one = {name = name}
  function one:init(wanted) self.name = wanted; return board.knows(wanted) end
  function one:get() return board.value(self.name) end
  function one:set(value) return board.add_param(self.name, value) end
  assert(name == nil or board.knows(name), "parameter not found")
  return one
end
"""
# The type of our own heartbeat, as it stands on the wire.
OURS = struct.unpack_from("<B", Encoder(*COMPANION_ADDRESS).heartbeat(), 10 + 4)[0]
GCS, QUADROTOR = 6, 2


def message_of(system: int, component: int, kind: int, wide: bool = False) -> bytes:
    """Return a heartbeat as ArduPilot gives it to scripts: its mavlink_message_t, with a system id of 8 or of 32 bits."""
    head = struct.pack("<HBBBBB", 0, 0xFD, 9, 0, 0, 7) + struct.pack("<IB" if wide else "<BB", system, component) + bytes(3)
    message = head + struct.pack("<IBBBBB", 0, kind, 8, 0, 4, 3)
    return message.ljust(299 if wide else 291, b"\0")


@dataclass
class Board:
    """An autopilot as the script sees it."""

    now_ms: int = 100_000
    armed: bool = True
    mode: int = GUIDED
    has_room: bool = True
    has_name: bool = True
    refuses: bool = False
    prefix: str = ""
    kind: int = -1
    wide: bool = False
    system_name: str = "MAV_GCS_SYSID"
    parameters: dict[str, float] = field(default_factory=lambda: {"FS_GCS_ENABLE": 5.0})
    waiting: list[bytes] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    orders: list[int] = field(default_factory=list)

    def boot(self) -> None:
        if self.system_name:
            self.parameters[self.system_name] = float(COMPANION_ADDRESS.system)
        lua = LuaRuntime()
        lua.globals().board = self
        lua.execute(BINDINGS)
        self._watch = lua.execute((FOLDER / "ardupilot_silence.lua").read_text(encoding="ascii"))[0]

    def run(self, for_s: float, *senders: tuple[int, int, int], heard: bool = False) -> None:
        """Let time pass while these send their heartbeats: system, component and type. heard: our own companion, too."""
        for _ in range(round(for_s * 20)):
            self.now_ms += 50
            for sender in (*senders, *([(*COMPANION_ADDRESS, OURS)] if heard else [])):
                self.waiting.append(message_of(*sender, wide=self.wide))
            self._watch, every_ms = self._watch()
            assert every_ms == 50

    def set_mode(self, mode: int) -> bool:
        self.orders.append(mode)
        self.mode = self.mode if self.refuses else mode
        return not self.refuses

    def receive(self) -> bytes | None:
        assert self.kind == 0, "only heartbeats are asked for"
        return self.waiting.pop(0) if self.waiting else None

    def knows(self, name: str) -> bool:
        return name in self.parameters

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
    assert b.parameters["FS_GCS_ENABLE"] == 0.0, "it would begin its wait again"
    b.armed = False
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 5.0
    b.parameters["FS_GCS_ENABLE"] = 1.0  # somebody's own, on the floor
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 1.0


@pytest.mark.parametrize("wide", [False, True], ids=["system id of 8 bits", "system id of 32 bits"])
@pytest.mark.parametrize("name", ["MAV_GCS_SYSID", "SYSID_MYGCS"])
def test_only_the_companion_itself_counts(wide: bool, name: str) -> None:
    """MAVSDK's default ids, our system id of another component, our ids of a ground station or of a vehicle."""
    others = [
        (245, 190, GCS),
        (245, COMPANION_ADDRESS.component, OURS),
        (COMPANION_ADDRESS.system, 190, OURS),
        (*COMPANION_ADDRESS, GCS),
        (*COMPANION_ADDRESS, QUADROTOR),
    ]
    b = board(wide=wide, system_name=name)
    b.run(5.0, *others, heard=True)
    assert b.orders == []
    b.run(1.5, *others)
    assert b.orders == []
    b.run(0.1, *others)
    assert b.orders == [LAND]


def test_a_companion_is_heard_among_others_that_send_more_often() -> None:
    b = board()
    b.run(10.0, *[(245, 190, GCS)] * 8, heard=True)
    assert b.orders == []


def test_our_heartbeat_is_the_one_that_the_script_asks_for() -> None:
    received = Decoder().feed(Encoder(*COMPANION_ADDRESS).heartbeat())[0]
    assert (received.system, received.component, OURS) == (233, 191, 18)


def test_ids_that_programs_have_by_default_are_not_ours() -> None:
    """MAVSDK, ground stations, mavp2p, MAVROS and autopilots, OpenHD, SiK radios."""
    assert COMPANION_ADDRESS.system not in (245, *range(250, 256), 125, *range(1, 60), 100, 101)


def test_what_it_gives_back_is_what_it_took_first() -> None:
    b = board()
    b.run(0.1, heard=True)
    b.run(2.0, heard=False)
    b.mode = GUIDED  # taken out of the landing, and silent still
    b.run(0.1, heard=False)
    assert b.orders == [LAND, LAND]
    b.armed = False
    b.run(0.1, heard=False)
    assert b.parameters["FS_GCS_ENABLE"] == 5.0


@pytest.mark.parametrize("given", [{"armed": False}, {"mode": LOITER}, {"mode": LAND}, {}])
def test_else_it_does_nothing(given: dict[str, object]) -> None:
    """On the floor, in a pilot's hands, landing already, with a companion that never was."""
    b = board(**given)
    b.run(0.1, heard=bool(given))
    b.run(5.0, heard=False)
    assert b.orders == []
    assert b.texts == []


def test_a_landing_that_is_refused_is_asked_for_again() -> None:
    b = board(refuses=True)
    b.run(0.1, heard=True)
    b.run(2.0, heard=False)
    assert len(b.orders) > 3
    assert b.texts == []
    assert b.parameters["FS_GCS_ENABLE"] == 5.0, "the firmware's own failsafe stays behind it"
    b.refuses = False
    b.run(1.0, heard=False)
    assert b.mode == LAND


def test_a_clock_that_wraps_is_no_silence() -> None:
    b = board(now_ms=0xFFFFFFFF - 1000)
    b.run(3.0, heard=True)
    assert b.orders == []


def test_its_parameter_is_the_one_that_is_read_before_arming() -> None:
    b = board()
    wanted = {one.name: one for one in load(PARAMETER_FILES["ardupilot"])}
    assert b.parameters["UVR_SILENCE_S"] == wanted["UVR_SILENCE_S"].value
    assert wanted["UVR_SILENCE_S"].reason.refused
    assert b.parameters["UVR_COMP_ID"] == wanted["UVR_COMP_ID"].value == COMPANION_ADDRESS.component
    assert wanted["UVR_COMP_ID"].reason.refused, "an older copy of the script does not ask for the component"
    assert wanted["MAV_GCS_SYSID"].value == COMPANION_ADDRESS.system
    assert wanted["SCR_ENABLE"].reason.refused
    b.parameters["UVR_SILENCE_S"] = 3.0
    b.run(0.1, heard=True)
    b.run(2.0, heard=False)
    assert b.orders == []


@pytest.mark.parametrize(
    ("lacks", "says"),
    [
        ({"has_room": False}, "no parameter table"),
        ({"has_name": False}, "no parameter(?! table)"),
        ({"system_name": ""}, "no system id"),
    ],
)
def test_without_its_parameters_it_does_not_run(lacks: dict[str, object], says: str) -> None:
    with pytest.raises(Exception, match=says):
        board(**lacks)

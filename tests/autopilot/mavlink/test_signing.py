"""Signatures, with pymavlink's own signing as the other side."""

from __future__ import annotations

import hashlib
import itertools
import math
import os
from pathlib import Path
from typing import Any

import pytest
from flight_rig import ARM, MODE, Tap
from hostile_traffic import Wire
from px4_link import px4_link
from pymavlink.dialects.v20 import ardupilotmega as wire
from signed_vehicle import SignedEnd, signer
from test_pilot_flight_ardupilot import CopterRig

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.byte_links import ByteEnd
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.codec import Decoder, Encoder
from uav_recon.autopilot.mavlink.signing import KeyFileError, Signature, open_signature, read_key
from uav_recon.autopilot.mavlink.signing_timestamps import UNITS_PER_S, SigningTimestamps
from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.types.vehicle import FlightPhase

KEY, OTHER_KEY = hashlib.sha256(b"one").digest(), hashlib.sha256(b"other").digest()
NOW_S = 1_795_000_000.0
NOW = int((NOW_S - 1420070400) * UNITS_PER_S)
HEARTBEAT = wire.MAVLink_heartbeat_message(2, 3, 0x80, 4, 4, 3)


def signature(folder: Path, wall_s: float = NOW_S, link_id: int = 1) -> Signature:
    return Signature(KEY, link_id, SigningTimestamps(folder / "stamps", wall_s, 0.0, InlineExecutor(ManualClock())))


class Ear:
    """A link that uses a key, and what it makes of frames."""

    def __init__(self, folder: Path, wall_s: float = NOW_S) -> None:
        self.far = Wire()
        self.allow_list = AllowListFilter(seal=signature(folder, wall_s))
        self.link = px4_link(self.far, self.allow_list)

    def believes(self, *frames: bytes) -> bool:
        """Whether these frames, all together, had an effect."""
        before, refused = self.link.telemetry.received_s, self.allow_list.refused
        self.now_s = 0.0 if math.isinf(before) else before + 1.0
        self.far.inbox = b"".join(frames)
        self.link.receive(self.now_s)
        changed = self.link.telemetry.received_s != before
        assert changed == (self.allow_list.refused - refused < len(frames))
        return changed


def frame_of(voice: Any, message: Any = HEARTBEAT) -> bytes:
    return bytes(message.pack(voice))


def test_pymavlink_believes_what_we_sign_and_nothing_else(tmp_path: Path) -> None:
    seal, mute = signature(tmp_path, link_id=9), Encoder(233, 191)
    frames = [seal.put(mute.heartbeat(), 0.1), seal.put(mute.timesync(1, 2), 0.1), seal.put(mute.command(1, 400, 1.0), 0.2)]
    there = signer(KEY, NOW, sender=(1, 1))
    said = there.parse_buffer(b"".join(frames))
    assert [m.get_type() for m in said] == ["HEARTBEAT", "TIMESYNC", "COMMAND_LONG"]
    assert [m.get_link_id() for m in said] == [9, 9, 9]
    assert there.signing.timestamp == NOW + UNITS_PER_S // 5
    for wrong in (frames[0], mute.heartbeat(), frames[2][:-1] + bytes((frames[2][-1] ^ 1,))):
        assert [m.get_type() for m in there.parse_buffer(wrong) or ()] == ["BAD_DATA"]
    stranger = signer(OTHER_KEY, NOW)
    assert [m.get_type() for m in stranger.parse_buffer(frames[0])] == ["BAD_DATA"]


def test_what_pymavlink_signs_is_believed_once(tmp_path: Path) -> None:
    ear, there = Ear(tmp_path), signer(KEY, NOW)
    frames = [frame_of(there) for _ in range(3)]
    assert [ear.believes(frame) for frame in frames] == [True] * 3
    assert [ear.believes(frame) for frame in frames] == [False] * 3
    assert ear.believes(frame_of(there))


@pytest.mark.parametrize("place", [5, 12, -13, -8, -1], ids=["system", "payload", "link", "time", "hash"])
def test_a_changed_byte_is_not_believed(tmp_path: Path, place: int) -> None:
    seal, frame = signature(tmp_path), bytearray(frame_of(signer(KEY, NOW)))
    assert seal.verify(bytes(frame))
    frame[place] ^= 1
    assert not seal.verify(bytes(frame))


def test_unsigned_and_wrongly_signed_frames_have_no_effect(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ear = Ear(tmp_path)
    plain, thief = wire.MAVLink(None, 1, 1), signer(OTHER_KEY, NOW + 100)
    radio = wire.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    late = wire.MAVLink_heartbeat_message(240, 3, 0x80, 0xFFFFFFFF, 4, 3)  # its bytes stand where a stamp of 2100 would
    assert not ear.believes(*[frame_of(plain, m) for m in (HEARTBEAT, late, radio)], frame_of(thief))
    assert (ear.link.telemetry.system, ear.far.sent) == (0, b"")
    assert ear.believes(frame_of(signer(KEY, NOW)))
    assert [r.getMessage() for r in caplog.records] == [
        "link: system 1, component 1 without a true and new signature: not listened to"
    ]


def test_a_forged_future_does_not_silence_the_vehicle(tmp_path: Path) -> None:
    """pymavlink notes the stamp before it looks at the signature: that is why its check is not used."""
    there, thief = signer(KEY, NOW), signer(OTHER_KEY, NOW + 3600 * UNITS_PER_S)
    ear, theirs = Ear(tmp_path), signer(KEY, NOW)
    assert ear.believes(frame_of(there))
    forged, true = frame_of(thief), frame_of(there)
    assert not ear.believes(forged)
    assert ear.believes(true)
    theirs.parse_buffer(forged)
    assert [m.get_type() for m in theirs.parse_buffer(true)] == ["BAD_DATA"]


@pytest.mark.parametrize("late_s", [1, 30, 90])
def test_a_capture_is_not_believed_again(tmp_path: Path, late_s: int) -> None:
    """Not by the same process, not after a restart of either, not with the wall clock set back."""
    ear, there = Ear(tmp_path), signer(KEY, NOW)
    captured = [frame_of(there) for _ in range(5)]
    assert ear.believes(*captured)
    assert not ear.believes(*captured)
    ear.allow_list.close()
    for wall_s in (NOW_S + late_s, NOW_S, NOW_S - 3600.0, 0.0):
        again = Ear(tmp_path, wall_s)
        assert not again.believes(*captured)
        again.allow_list.close()


def test_a_capture_of_another_link_is_a_minute_old_at_most(tmp_path: Path) -> None:
    ear = Ear(tmp_path)
    old = frame_of(signer(KEY, NOW - 61 * UNITS_PER_S, link_id=3))
    assert not ear.believes(old)


@pytest.mark.parametrize("late_s", [0, 1, 30])
def test_a_capture_of_another_link_is_not_believed_once_the_vehicle_is_heard(tmp_path: Path, late_s: int) -> None:
    ear, there, elsewhere = Ear(tmp_path), signer(KEY, NOW), signer(KEY, NOW - late_s * UNITS_PER_S, link_id=3)
    assert ear.believes(frame_of(there))
    assert not ear.believes(frame_of(elsewhere))
    assert ear.believes(frame_of(there))


def test_our_own_frames_come_back_as_a_twin_and_nothing_else(tmp_path: Path) -> None:
    ear = Ear(tmp_path)
    ear.link.keep_alive(0.0)
    assert Decoder().feed(ear.far.sent)[0].frame[2] == 1
    ear.far.inbox = ear.far.sent
    ear.link.receive(0.1)
    assert (ear.link.status.own_id_in_use, ear.link.telemetry.system) == (True, 0)


def test_only_a_signed_heartbeat_greets(tmp_path: Path) -> None:
    allow_list, there = AllowListFilter(seal=signature(tmp_path)), signer(KEY, NOW)
    signed = frame_of(there)
    assert not allow_list.has_heartbeat(frame_of(wire.MAVLink(None, 1, 1)))
    assert not allow_list.has_heartbeat(frame_of(signer(OTHER_KEY, NOW)))
    assert allow_list.has_heartbeat(signed)
    assert allow_list.has_heartbeat(signed), "to ask uses nothing up"


class SignedRig(CopterRig):
    """A flight in which both ends use a key."""

    def __init__(self, folder: Path, theirs: bytes = KEY) -> None:
        self._folder = folder
        self._their_key = theirs
        super().__init__()

    def allow_list(self) -> AllowListFilter:
        return AllowListFilter(seal=signature(self._folder))

    def _make_autopilot(self, end: ByteEnd, seed: int) -> ArduCopter:
        self.end = SignedEnd(end, self._their_key, NOW - 20 * UNITS_PER_S)  # it has no clock of its own
        return ArduCopter(self.vehicle, self.end, ArduPilotParameters.load(), seed)


def test_a_signed_handshake_arms_and_takes_off(tmp_path: Path) -> None:
    rig = SignedRig(tmp_path)
    rig.until(FlightPhase.READY, 40.0)
    rig.fly((0.0, 0.0, 1.1))
    rig.until(FlightPhase.FLYING, 15.0)
    rig.run(3.0)
    assert rig.height_m > 0.3
    names = {Tap.name(message) for _, message in rig.tap.sent}
    assert {f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}"} <= names
    assert (rig.end.refused, len(rig.end.believed) > 300) == (0, True)


class WallRig(SignedRig):
    """One whose key and stamps are files, and whose wall clock is set in flight, the whole process's too."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_s = NOW_S
        self.asked_s = list[float]()
        monkeypatch.setattr("time.time", self.wall)
        key = folder / "key"
        key.write_bytes(KEY)
        key.chmod(0o600)
        super().__init__(folder)

    def wall(self) -> float:
        self.asked_s.append(self.wall_s)
        return self.wall_s

    def allow_list(self) -> AllowListFilter:
        return AllowListFilter(seal=open_signature(self._folder / "key", 1, self._folder / "stamps", self.clock, self.wall))


@pytest.mark.nightly
def test_a_wall_clock_that_is_set_in_flight_is_not_felt_by_a_signed_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, wire_bytes = WallRig(tmp_path, monkeypatch), list[bytes]()
    write = rig.tap.write

    def keep(data: bytes) -> None:
        wire_bytes.append(data)
        write(data)

    monkeypatch.setattr(rig.tap, "write", keep)
    rig.take_off_and_hover()
    for wall_s in (NOW_S + 3600.0, NOW_S - 3600.0, 0.0, NOW_S):
        rig.wall_s = wall_s
        refused, believed = rig.end.refused, len(rig.end.believed)
        rig.run(7.0)  # longer than the stamps' file is ahead of them
        assert rig.end.refused == refused
        assert len(rig.end.believed) - believed > 200, "it goes on being heard"
        assert rig.clock.now_s() - rig.pilot._link.telemetry.received_s < 0.15, "and hears"
    stamps = [Signature._stamp(frame) for frame in wire_bytes]
    assert all(after > before for before, after in itertools.pairwise(stamps))
    assert rig.autopilot.failsafes == []
    assert rig.pilot.phase is FlightPhase.FLYING
    assert rig.asked_s.count(NOW_S) == len(rig.asked_s), "no clock of the wall is read in flight"


def test_with_another_key_nobody_hears_anybody(tmp_path: Path) -> None:
    rig = SignedRig(tmp_path, OTHER_KEY)
    rig.run(5.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.end.believed == []
    assert {Tap.name(message) for _, message in rig.tap.sent} == {"HEARTBEAT"}


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (bytes(range(200, 232)), bytes(range(200, 232))),
        (b"\0" * 32, b"\0" * 32),
        (b"correct horse battery", hashlib.sha256(b"correct horse battery").digest()),
        (b"correct horse battery\n", hashlib.sha256(b"correct horse battery").digest()),
        (b"0123456789" * 3 + b"x\n", hashlib.sha256(b"0123456789" * 3 + b"x").digest()),
    ],
)
def test_a_key_is_bytes_or_a_passphrase(tmp_path: Path, content: bytes, key: bytes) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert read_key(path) == key
    path.chmod(0o400)
    assert read_key(path) == key


@pytest.mark.parametrize(
    ("content", "mode", "says"),
    [
        (bytes(range(200, 231)), 0o600, "31 bytes, want 32, or one line of text as a passphrase"),
        (bytes(range(200, 233)), 0o600, "33 bytes, want 32"),
        (b"two\nlines of text\n", 0o600, "18 bytes, want 32"),
        (b"x" * 2000, 0o600, "bytes, want 32"),
        (b"short", 0o600, "a passphrase of 5 bytes, want 8 at least"),
        (b"", 0o600, "a passphrase of 0 bytes"),
        (b"correct horse battery", 0o640, "permissions 0640, want 0600"),
        (b"correct horse battery", 0o602, "permissions 0602, want 0600"),
    ],
)
def test_a_key_that_cannot_be_used_is_one_line_without_it(tmp_path: Path, content: bytes, mode: int, says: str) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match=says) as caught:
        read_key(path)
    assert str(caught.value).startswith(f"signing_key {path}: ")
    assert "horse" not in str(caught.value)


def test_a_key_must_be_a_file_of_its_own(tmp_path: Path) -> None:
    true = tmp_path / "true"
    true.write_bytes(b"correct horse battery")
    true.chmod(0o600)
    link, pipe = tmp_path / "link", tmp_path / "pipe"
    link.symlink_to(true)
    os.mkfifo(pipe, 0o600)
    for path, says in ((link, "cannot be read"), (pipe, "not a file"), (tmp_path, "not a file"), (tmp_path / "no", "No such")):
        with pytest.raises(KeyFileError, match=says):
            read_key(path)

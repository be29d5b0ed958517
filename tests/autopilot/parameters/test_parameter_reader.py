"""What a parameter's number means, and asking for many of them."""

from __future__ import annotations

import struct
from collections import Counter
from typing import Any

import pytest
from px4_link import px4_link
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.autopilot.parameters.reader import BYTEWISE, NUMERIC, PATIENCE_S, TRIES, WINDOW, ParameterReader

INT32, REAL32 = 6, 9


class Far:
    """The other end of a byte link: an autopilot that answers some names."""

    def __init__(self, **values: float) -> None:
        self.values = values
        self.deaf_for = Counter[str]()
        self.asked: list[str] = []
        self._inbox = b""
        self._voice = wire.MAVLink(None, 1, 1)
        self.say(wire.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))

    def say(self, message: Any) -> None:
        self._inbox += bytes(message.pack(self._voice))
        self._voice.seq = (self._voice.seq + 1) % 256

    def read(self) -> bytes:
        data = self._inbox
        self._inbox = b""
        return data

    def write(self, data: bytes) -> None:
        message: Any = wire.MAVLink(None).decode(bytearray(data))
        name = message.param_id
        self.asked.append(name)
        if self.deaf_for[name] > 0:
            self.deaf_for[name] -= 1
        elif name in self.values:
            self.say(wire.MAVLink_param_value_message(name.encode(), self.values[name], REAL32, 1, 0))

    def wait(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass


def linked(far: Far) -> VehicleLink:
    link = px4_link(far)
    link.receive(0.0)
    return link


def run(inquiry: ParameterReader, link: VehicleLink, seconds: float, begin_s: float = 0.0) -> float:
    """Until it is done; when that was."""
    for i in range(int(seconds / 0.01)):
        now_s = begin_s + i * 0.01
        link.receive(now_s)
        inquiry.step(now_s, link)
        if inquiry.done:
            return now_s
    raise AssertionError(f"not done after {seconds} s: {inquiry.progress}")


@pytest.mark.parametrize("value", [0, 1, 4, -1, 121212, 1_000_000, 2**31 - 1, -(2**31)])
def test_px4_tells_integers_as_bytes_and_ardupilot_as_numbers(value: int) -> None:
    as_bytes = struct.unpack("<f", struct.pack("<i", value))[0]
    assert BYTEWISE.value_of(ParameterValue("X", as_bytes, INT32)) == value
    assert struct.pack("<f", BYTEWISE.number_of(value, INT32)) == struct.pack("<i", value)
    for kind in (2, 4, INT32, REAL32):
        assert NUMERIC.value_of(ParameterValue("X", float(value), kind)) == value
        assert NUMERIC.number_of(value, kind) == value
    assert BYTEWISE.number_of(0.25, REAL32) == BYTEWISE.value_of(ParameterValue("X", 0.25, REAL32)) == 0.25


@pytest.mark.parametrize("form", [BYTEWISE, NUMERIC])
@pytest.mark.parametrize("value", [0.5, 2.0**31])
def test_what_an_integer_cannot_hold_is_refused(form: Any, value: float) -> None:
    with pytest.raises(ValueError, match="32 bits"):
        form.number_of(value, INT32)


def test_all_are_read_a_few_at_a_time() -> None:
    values = {f"P{i}": i / 4 for i in range(40)}
    far = Far(**values)
    link, inquiry = linked(far), ParameterReader(values)
    inquiry.step(0.0, link)
    assert far.asked == list(values)[:WINDOW]
    run(inquiry, link, 2.0)
    assert far.asked == list(values)
    assert {name: told.number for name, told in link.telemetry.parameters.items()} == values
    assert inquiry.silent == []


def test_a_lost_answer_is_asked_for_again() -> None:
    far = Far(A=1.0, B=2.0)
    far.deaf_for["A"] = TRIES - 1
    link, inquiry = linked(far), ParameterReader(["A", "B"])
    took_s = run(inquiry, link, 10.0)
    assert took_s == pytest.approx((TRIES - 1) * PATIENCE_S, abs=0.05)
    assert far.asked.count("A") == TRIES
    assert far.asked.count("B") == 1
    assert link.telemetry.parameters["A"].number == 1.0


def test_what_is_unknown_there_is_given_up_and_named() -> None:
    far = Far(A=1.0)
    link, inquiry = linked(far), ParameterReader(["NOT_THERE", "A"])
    run(inquiry, link, 10.0)
    assert inquiry.silent == ["NOT_THERE"]
    assert far.asked.count("NOT_THERE") == TRIES


def test_an_old_answer_does_not_count_for_a_new_question() -> None:
    far = Far(A=1.0)
    link = linked(far)
    run(ParameterReader(["A"]), link, 1.0)
    far.values["A"] = 5.0
    again = ParameterReader(["A"])
    again.step(1.0, link)
    assert not again.done
    run(again, link, 1.0, begin_s=1.01)
    assert link.telemetry.parameters["A"].number == 5.0


def test_nobody_can_fill_us_with_parameters_that_nobody_asked_for() -> None:
    far = Far()
    link = linked(far)
    for i in range(2000):
        far.say(wire.MAVLink_param_value_message(f"P{i}".encode(), 1.0, REAL32, 1, 0))
        link.receive(0.0)
    assert link.telemetry.parameters == {}

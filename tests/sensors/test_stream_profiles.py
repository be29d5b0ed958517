"""Choice of a camera's streams from its offers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_recon.sensors.stream_profiles import NoProfileError, StreamKind, StreamProfile, choose_streams

KINDS = {"d": StreamKind.DEPTH, "c": StreamKind.COLOUR, "g": StreamKind.GYRO, "a": StreamKind.ACCEL}


def _offers(*texts: str) -> list[StreamProfile]:
    """Return offers written as d424x240@30 or g200."""
    found: list[StreamProfile] = []
    for text in texts:
        size, _, rate = text[1:].rpartition("@")
        width, _, height = size.partition("x")
        found.append(StreamProfile(KINDS[text[0]], int(rate), int(width or 0), int(height or 0), index=len(found)))
    return found


def _chosen(*texts: str, usb2: bool = False) -> tuple[str, str]:
    choice = choose_streams(_offers(*texts), usb2)
    return choice.depth.text(), choice.colour.text()


@pytest.mark.parametrize(
    ("offers", "wanted"),
    [
        (
            ("d848x480@30", "d424x240@30", "d480x270@30", "c424x240@30", "c1280x720@30"),
            ("424x240 at 30 Hz", "424x240 at 30 Hz"),
        ),
        (("d480x270@15", "d640x480@6", "c424x240@15", "c640x480@30"), ("480x270 at 15 Hz", "424x240 at 15 Hz")),
        (("d640x480@30", "d424x240@15", "c640x480@30", "c424x240@15"), ("640x480 at 30 Hz", "640x480 at 30 Hz")),
        (("d424x240@30", "d424x240@15", "c640x480@15"), ("424x240 at 15 Hz", "640x480 at 15 Hz")),
        (("d424x240@90", "d848x480@30", "c1920x1080@30", "c640x480@30"), ("848x480 at 30 Hz", "640x480 at 30 Hz")),
    ],
)
def test_the_preferred_streams_are_taken(offers: tuple[str, ...], wanted: tuple[str, str]) -> None:
    assert _chosen(*offers) == wanted


def test_on_usb2_a_pair_fits_the_bus() -> None:
    offers = ("d640x480@30", "c640x480@30", "d640x480@15", "c640x480@15")
    assert _chosen(*offers) == ("640x480 at 30 Hz", "640x480 at 30 Hz")
    assert _chosen(*offers, usb2=True) == ("640x480 at 15 Hz", "640x480 at 15 Hz")


@pytest.mark.parametrize(
    ("offers", "gyro_hz", "accel_hz"),
    [
        (("g@200", "g@400", "a@63", "a@250"), 200, 63),
        (("g@400", "a@250", "a@100"), 400, 100),
        (("g@1600", "a@1600"), 1600, 1600),
        (("g@200",), None, None),
        ((), None, None),
    ],
)
def test_inertial_rates_are_those_offered_and_optional(
    offers: tuple[str, ...], gyro_hz: int | None, accel_hz: int | None
) -> None:
    choice = choose_streams(_offers("d424x240@30", "c424x240@30", *offers))
    assert (choice.gyro and choice.gyro.rate_hz, choice.accel and choice.accel.rate_hz) == (gyro_hz, accel_hz)
    assert ("no IMU offered" in choice.reason) is (gyro_hz is None)


def test_where_nothing_fits_one_line_names_the_offers() -> None:
    with pytest.raises(NoProfileError, match=r"offered depth 1280x720 at 6 Hz; colour none$") as error:
        choose_streams(_offers("d1280x720@6"))
    assert "\n" not in str(error.value)
    assert "424x240 to 848x480 at 30 or 15 Hz" in str(error.value)


SIZES = st.sampled_from(["424x240", "480x270", "640x360", "640x480", "848x480", "1280x720"])
VIDEO = st.builds(
    lambda kind, size, rate: f"{kind}{size}@{rate}", st.sampled_from("dc"), SIZES, st.sampled_from([6, 15, 30, 60])
)


@given(st.lists(VIDEO, max_size=20), st.booleans())
def test_a_choice_is_among_the_offers_and_does_not_depend_on_their_order(texts: list[str], usb2: bool) -> None:
    offers = _offers(*texts)
    try:
        choice = choose_streams(offers, usb2)
    except NoProfileError:
        with pytest.raises(NoProfileError):
            choose_streams(reversed(offers), usb2)
        return
    assert choice.depth in offers
    assert choice.colour in offers
    assert choice.depth.rate_hz == choice.colour.rate_hz in (15, 30)
    again = choose_streams(reversed(offers), usb2)
    assert (again.depth.text(), again.colour.text()) == (choice.depth.text(), choice.colour.text())

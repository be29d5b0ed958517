"""The codes that the campaign asks for are the product's, and each is one that can be found in a STATUSTEXT."""

from __future__ import annotations

import pytest

from sitl.faults import reason_codes
from uav_recon.types.reason import Reason, codes_in
from uav_recon.types.reason_code import ReasonCode

NAMED = {name: value for name, value in vars(reason_codes).items() if name.isupper()}
ASKED_FOR = sorted({code for value in NAMED.values() for code in ((value,) if isinstance(value, str) else value)})


def test_there_are_codes_to_check() -> None:
    assert len(ASKED_FOR) > 40
    assert all(isinstance(code, str) and not isinstance(code, ReasonCode) for code in ASKED_FOR)


@pytest.mark.parametrize("code", ASKED_FOR)
def test_each_code_is_one_of_the_products(code: str) -> None:
    member = {each.value: each for each in ReasonCode}[code]
    assert codes_in(Reason(member, member.example).short()) == (code,)

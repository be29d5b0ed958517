"""Reasons: the table of messages, the characters of a STATUSTEXT, and the codes that are found in one again."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest

from uav_recon.channels import decode, encode
from uav_recon.types.reason import STATUSTEXT_BYTES, Reason, autopilot_text, codes_in, codes_of, text_of
from uav_recon.types.reason_code import ReasonCode

ROOT = Path(__file__).parents[2]
PRODUCT = [path for path in (ROOT / "uav_recon").rglob("*.py") if path.name != "reason_code.py"]


def largest(code: ReasonCode) -> Reason:
    return Reason(code, code.example)


@pytest.mark.parametrize("code", ReasonCode)
def test_each_code_has_a_short_text_for_a_statustext_and_a_long_one(code: ReasonCode) -> None:
    short, long = (template.format(*code.example) for template in (code.short, code.long))
    assert 0 < len(short.encode("ascii")) <= STATUSTEXT_BYTES
    assert largest(code).short() == short
    assert largest(code).text() == long
    assert code.value == code.value.lower()
    assert " " not in code.value


@pytest.mark.parametrize("code", [code for code in ReasonCode if code is not ReasonCode.AUTOPILOT_TEXT])
def test_a_code_is_found_in_its_statustext(code: ReasonCode) -> None:
    assert codes_in(largest(code).short()) == (code.value,)
    for number in (0.0, -0.04, math.inf, math.nan):
        values = tuple(v if isinstance(v, str | int) else number for v in code.example)
        assert codes_in(Reason(code, values).short()) == (code.value,)
    refused = Reason(ReasonCode.REFUSED, details=(largest(code),))
    assert codes_in(refused.short()) == ("refused", code.value)


def test_every_code_is_used_and_made_with_as_many_values_as_its_texts_show() -> None:
    used: set[str] = set()
    for path in PRODUCT:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ReasonCode":
                used.add(node.attr)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Reason":
                check_values(node, f"{path.relative_to(ROOT)}:{node.lineno}")
    assert used == {code.name for code in ReasonCode}


def check_values(call: ast.Call, where: str) -> None:
    """A call with a code and a tuple written out has one value for each index of the code's texts."""
    code = call.args[0]
    values = call.args[1] if len(call.args) > 1 else ast.Tuple([])
    if not isinstance(code, ast.Attribute) or not isinstance(values, ast.Tuple):
        return
    if not any(isinstance(value, ast.Starred) for value in values.elts):
        member = ReasonCode[code.attr]
        assert len(values.elts) == len(member.example) == len(member.digits), where


def test_details_follow_their_reason_in_texts_and_codes() -> None:
    why = Reason(ReasonCode.NO_POSE, (1.04,)).with_detail(Reason(ReasonCode.HELD_TOO_LONG, (20.0,)))
    both = why.with_detail(Reason(ReasonCode.CLOCK_UNCERTAIN))
    assert both.text() == "no pose for 1.0 s: held for 20 s, autopilot clock uncertain"
    assert both.codes() == ("no-pose", "held-too-long", "clock-uncertain")
    assert codes_in(both.short()) == both.codes(), "the last one is cut, and no other begins so"
    assert codes_in(both.short()[:40]) == ("no-pose", "held-too-long"), "not cut by the message: another text"


def test_a_cut_text_that_may_be_of_several_codes_is_none_of_them() -> None:
    blocked = Reason(ReasonCode.RETREAT_BLOCKED, details=(Reason(ReasonCode.NOT_KNOWN_FREE, (1.0, 2.0, 3.0)),))
    said = Reason(ReasonCode.MISSION_SILENT, (12.0,), (blocked,)).short()
    assert said == "mission silent for 12.0 s: retreat blocked: not kn"
    assert codes_in(said) == ("mission-silent", "retreat-blocked", "not-known-free")
    longer = Reason(ReasonCode.MISSION_SILENT, (1234.0,), (blocked,)).short()
    assert longer == "mission silent for 1234.0 s: retreat blocked: not "
    assert codes_in(longer) == ("mission-silent", "retreat-blocked")


@pytest.mark.parametrize("text", ["", "Arming motors", "no pose", "failsafe", "refusedly", "the mission is silent or not"])
def test_other_texts_have_no_code(text: str) -> None:
    assert codes_in(text) == ()


def test_the_autopilots_own_text_is_a_detail_without_a_code_on_the_wire() -> None:
    lands = Reason(ReasonCode.AUTOPILOT_LANDS, details=autopilot_text("Failsafe: no pose for 1.0 s, descending"))
    assert lands.text() == "the autopilot lands: Failsafe: no pose for 1.0 s, descending"
    assert codes_in(lands.short()) == ("autopilot-lands",)
    assert autopilot_text("") == ()


def test_reasons_with_equal_texts_are_equal() -> None:
    assert Reason(ReasonCode.NO_POSE, (0.31,)) == Reason(ReasonCode.NO_POSE, (0.29,))
    assert Reason(ReasonCode.NO_POSE, (0.31,)) != Reason(ReasonCode.NO_POSE, (0.42,))
    assert Reason(ReasonCode.NO_POSE, (math.nan,)) == Reason(ReasonCode.NO_POSE, (float("nan"),))
    assert Reason(ReasonCode.SURFACES_GONE, (0.421, 1.0)) == Reason(ReasonCode.SURFACES_GONE, (0.424, 1.2))


@pytest.mark.parametrize("values", [(), ("fast",), (1.0, 2.0), (math.inf,)])
def test_a_text_is_made_of_whatever_values_another_process_gives(values: tuple[float | str, ...]) -> None:
    assert "speed" in Reason(ReasonCode.SPEED_LIMIT, values).text()


def test_what_another_process_gives_stays_small() -> None:
    deep = Reason(ReasonCode.REFUSED)
    for _ in range(40):
        deep = Reason(ReasonCode.REFUSED, ("x" * 9999,) * 99, (deep,))
    assert len(deep.codes()) <= 6
    shallow = Reason(ReasonCode.LINK_ERROR, ("x" * 9999,) * 99)
    assert len(shallow.text()) < 200
    assert len(shallow.values) < 20


def test_a_reason_comes_back_from_a_channel() -> None:
    for code in ReasonCode:
        said = Reason(code, code.example, (largest(ReasonCode.PARAMETER_DIFFERS),))
        assert decode(encode(said), Reason) == said
    for tree in (b'["no-pose", [[1]], []]', b'["no-pose", [null], 3]', b'["no-pose", [true], []]'):
        with pytest.raises(ValueError, match=r"none of|not a"):
            decode(len(tree).to_bytes(4, "little") + tree, Reason)


def test_no_reason_has_no_text_and_no_codes() -> None:
    assert (text_of(None), codes_of(None)) == ("", ())
    assert text_of(Reason(ReasonCode.NO_ORIGIN)) == "no origin yet"
    assert codes_of(Reason(ReasonCode.NO_ORIGIN)) == ("no-origin",)

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_recon import json_codec
from uav_recon.json_codec import Float


@dataclass(frozen=True)
class Camera:
    name: Literal["wide", "fast"]
    offset_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Flight:
    scene: str
    views: int
    camera: Camera | None
    times_s: Mapping[str, float | None]
    path: tuple[tuple[int, float], ...] = ()
    speed_mps: Float = 0.0


FLIGHT = Flight("Küche", 3, Camera("wide", (0.1, -0.2)), {"0.90": 1e-05, "0.95": None}, ((1, 2.0), (2, 1e22)), 0.3)
LINE = (
    '{"scene": "K\\u00fcche", "views": 3, "camera": {"name": "wide", "offset_m": [0.1, -0.2]}, '
    '"times_s": {"0.90": 1e-05, "0.95": null}, "path": [[1, 2.0], [2, 1e+22]], "speed_mps": 0.3}'
)


def test_a_value_is_one_line_in_the_order_of_its_fields() -> None:
    assert json_codec.to_line(FLIGHT) == LINE


def test_a_page_is_indented_and_keeps_letters() -> None:
    assert json_codec.to_page(FLIGHT) == json.dumps(json.loads(LINE), indent=1, ensure_ascii=False) + "\n"
    assert "Küche" in json_codec.to_page(FLIGHT)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, np.float32("nan")])
def test_a_number_that_is_not_finite_is_null_and_is_read_as_nan_where_the_type_says_so(number: Any) -> None:
    line = json_codec.to_line(Flight("", 0, None, {}, (), number))
    assert line.endswith('"speed_mps": null}')
    assert math.isnan(json_codec.from_text(Flight, line).speed_mps)
    with pytest.raises(ValueError, match=r"camera\.offset_m\[1\]: input should be a valid number, got None"):
        json_codec.from_text(Flight, LINE.replace("-0.2", "null"))


def test_numpy_numbers_are_numbers() -> None:
    assert json_codec.to_tree({"a": np.int64(3), "b": [np.float32(0.5), np.bool_(True)]}) == {"a": 3, "b": [0.5, True]}


def test_a_value_is_read_back_unchanged() -> None:
    assert json_codec.from_text(Flight, LINE) == FLIGHT
    assert json_codec.from_tree(Flight, json_codec.to_tree(FLIGHT)) == FLIGHT


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**63), 2**63))
def test_each_number_is_read_back_to_the_last_bit(number: float, whole: int) -> None:
    flight = Flight("", whole, None, {"": number})
    assert json_codec.from_text(Flight, json_codec.to_line(flight)) == flight


def test_an_integer_is_a_float_and_a_missing_value_has_its_default() -> None:
    flight = json_codec.from_text(Flight, '{"scene": "", "views": 1, "camera": null, "times_s": {"0.90": 3}}')
    assert flight == Flight("", 1, None, {"0.90": 3.0})
    assert type(flight.times_s["0.90"]) is float


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('"scene": "K\\u00fcche", ', "", "scene: missing"),
        ('"views"', '"bumps": 1, "views"', "bumps: unknown key"),
        ('"name"', '"lens": 2, "name"', r"camera\.lens: unknown key"),
        ("3", "true", "views: input should be a valid integer, got True"),
        ("3", "3.5", "views: input should be a valid integer, got 3.5"),
        ("3", '"3"', "views: input should be a valid integer, got '3'"),
        ('"wide"', '"zoom"', r"camera\.name: input should be 'wide' or 'fast', got 'zoom'"),
        ("[0.1, -0.2]", "[0.1]", r"camera\.offset_m\[1\]: missing"),
        (LINE, "[]", r"top level: input should be an object, got \[\]"),
        (LINE, "{", "top level: invalid JSON: EOF while parsing"),
        (LINE, "[" * 10000, "top level: invalid JSON: recursion limit exceeded"),
    ],
)
def test_the_first_fault_is_named_in_one_line(old: str, new: str, line: str) -> None:
    assert LINE.count(old) >= 1
    with pytest.raises(ValueError, match=line) as refused:
        json_codec.from_text(Flight, LINE.replace(old, new, 1))
    assert len(str(refused.value).splitlines()) == 1


def test_a_tree_that_is_nested_too_deeply_is_refused() -> None:
    tree: list[Any] = []
    for _ in range(100_000):
        tree = [tree]
    with pytest.raises(ValueError, match="nested too deeply"):
        json_codec.from_tree(Flight, tree)

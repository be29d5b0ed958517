"""Dataclasses as JSON, for the files and messages of this program.

Encoding: a dataclass is a table in the order of its fields, a tuple a list, and a number that is not finite null, because JSON
has no NaN. Decoding, by pydantic, is strict: each key must be known and each value of the declared type; an integer is also a
float.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from pydantic import BeforeValidator, TypeAdapter, ValidationError

T = TypeVar("T")

Float = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]  # null is read as NaN
_TEXT = {"unexpected_keyword_argument": "unknown key", "missing": "missing"}


def to_tree(value: Any) -> Any:
    """Return a value as dicts, lists, numbers and text."""
    if dataclasses.is_dataclass(value):
        return {field.name: to_tree(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: to_tree(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_tree(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_line(value: Any) -> str:
    """Return a value as one line of JSON in ASCII, without the line's end."""
    return json.dumps(to_tree(value), allow_nan=False)


def to_page(value: Any) -> str:
    """Return a value as indented JSON for a file that people read, too."""
    return json.dumps(to_tree(value), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def from_text(kind: type[T], text: str | bytes) -> T:
    """Return the value of a JSON text.

    Raises ValueError with one line that names the first missing, unknown or mistyped key.
    """
    try:
        return cast("T", _adapter(cast("Any", kind)).validate_json(text, strict=True, extra="forbid"))
    except ValidationError as error:
        raise ValueError(_line(error)) from None


def from_tree(kind: type[T], tree: Any) -> T:
    """Return the value of parsed JSON, with the rules and errors of from_text()."""
    try:
        text = json.dumps(tree)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return from_text(kind, text)


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _line(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).removeprefix(".")
    kind, said = first["type"], first["msg"]
    got = "" if kind == "json_invalid" else f", got {first['input']!r}"
    fault = _TEXT.get(kind) or f"{said[0].lower()}{said[1:]}{got}"
    return f"{where or 'top level'}: {fault}"

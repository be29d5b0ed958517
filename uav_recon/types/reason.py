"""Reasons as values: a code, its numbers and its details, with texts for people.

No program compares a text.
"""

from __future__ import annotations

import functools
import math
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass

from uav_recon.types.reason_code import ReasonCode, Value

STATUSTEXT_BYTES = 50  # size of MAVLink's text field
_NUMBER = r"[-+.\de]+%?|inf%?|nan%?"
_MAX_VALUES = 8
_MAX_CHARACTERS = 100
_MAX_DETAILS = 16
_MAX_DEPTH = 6


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why something is not done, or is done otherwise; None stands for no reason.

    values: values in the texts of the code, rounded to the displayed digits, so equal texts are equal reasons.
    details: further reasons in order, such as the reason why the autopilot gave up.

    A reason from another process is kept small: long text values are cut, and details that are nested too deep are dropped.
    """

    code: ReasonCode
    values: tuple[Value, ...] = ()
    details: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        digits = (*self.code.digits, *(None,) * _MAX_VALUES)
        values = tuple(_rounded(value, places) for value, places in zip(self.values, digits, strict=False))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "details", self.details[:_MAX_DETAILS] if _depth(self) <= _MAX_DEPTH else ())

    def with_detail(self, detail: Reason) -> Reason:
        """Return the same reason with one more detail behind the others."""
        return Reason(self.code, self.values, (*self.details, detail))

    def codes(self) -> tuple[str, ...]:
        """Return its code and those of its details, depth first."""
        return (self.code.value, *(code for detail in self.details for code in detail.codes()))

    def short(self) -> str:
        """Return the text for a STATUSTEXT: at most 50 bytes of ASCII, the rest is cut off."""
        return self._in_full(brief=True).encode("ascii", "replace")[:STATUSTEXT_BYTES].decode("ascii")

    def text(self) -> str:
        """Return the text for logs and screens."""
        return self._in_full(brief=False)

    def _in_full(self, brief: bool) -> str:
        """Return the text with its details.

        It never raises, whatever the values are: they may come from another process.
        """
        template = self.code.short if brief else self.code.long
        try:
            head = template.format(*self.values)
        except (LookupError, TypeError, ValueError):
            head = " ".join(map(str, (self.code.value, *self.values)))
        return head + (": " if self.details else "") + ", ".join(detail._in_full(brief) for detail in self.details)


def autopilot_text(text: str) -> tuple[Reason, ...]:
    """Return the autopilot's newest text as a detail; none if it gave none."""
    return (Reason(ReasonCode.AUTOPILOT_TEXT, (text,)),) if text else ()


def text_of(reason: Reason | None) -> str:
    """Return the text for logs and screens, '' for no reason."""
    return "" if reason is None else reason.text()


def codes_of(reason: Reason | None) -> tuple[str, ...]:
    """Return a reason's codes, none for no reason."""
    return () if reason is None else reason.codes()


def codes_in(statustext: str) -> tuple[str, ...]:
    """Return the codes in a STATUSTEXT made by ``Reason.short``, in its order.

    It returns none for any other text. A code whose text is cut off at 50 bytes is found if the rest belongs to one code
    only.
    """
    return tuple(_codes_in(statustext, was_cut=len(statustext.encode()) >= STATUSTEXT_BYTES))


def _codes_in(rest: str, was_cut: bool) -> Iterator[str]:
    while rest:
        begun = [code for code, _ in _patterns() if _begins(code, rest)] if was_cut else []
        if len(begun) == 1:
            yield begun[0].value
            return
        found = [(match.end("own"), code) for code, pattern in _patterns() if (match := pattern.match(rest))]
        if not found:
            return
        end, code = max(found, key=lambda pair: (len(pair[1].short), pair[0]))
        yield code.value
        rest = rest[end:].removeprefix(":").removeprefix(",").removeprefix(" ")


@functools.cache
def _patterns() -> tuple[tuple[ReasonCode, re.Pattern[str]], ...]:
    """Return the codes with a text of their own, each with the pattern of its short text."""
    return tuple((code, _pattern(code.short)) for code in ReasonCode if code is not ReasonCode.AUTOPILOT_TEXT)


def _pattern(template: str) -> re.Pattern[str]:
    parts = []
    for literal, name, spec, _ in string.Formatter().parse(template):
        parts.append(re.escape(literal))
        if name is not None:
            parts.append(f"(?:{_NUMBER})" if spec else r"(?:(?!: ).)+?")
    return re.compile(rf"(?P<own>{''.join(parts)})(?:$|: |, )")


def _begins(code: ReasonCode, cut: str) -> bool:
    """Return whether a cut text may be the beginning of a code's short text."""
    for literal, name, spec, _ in string.Formatter().parse(code.short):
        if not cut.startswith(literal):
            return literal.startswith(cut)
        cut = cut[len(literal) :]
        if name is not None:
            value = re.match(_NUMBER if spec else r"[^\s,]+", cut)
            cut = cut[value.end() :] if value else cut
            if not value:
                return not cut
        if not cut:
            return True
    return False


def _rounded(value: Value, places: int | None) -> Value:
    if isinstance(value, str):
        return value[:_MAX_CHARACTERS]
    if math.isnan(value):
        return math.nan  # always the same object, so that reasons with it are equal
    return value if places is None else round(value, places)


def _depth(reason: Reason) -> int:
    return 1 + max((_depth(detail) for detail in reason.details), default=0)

"""Description of one field of an options class for the command line and its check.

Imports nothing heavy: the help of `uav-recon` loads it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, get_type_hints

from uav_recon.app.option_validation import UsageError


@dataclass(frozen=True)
class CommandOption:
    """Metadata of a field, as `name: Annotated[type, CommandOption(...)] = default`.

    flag: as typed; without one it is the name of the field. words: the only accepted values. offered: what completion offers
    if the values are not words. whole: lowest and highest whole number, None for no highest; the parser checks them. limits,
    unit: lowest and highest number. renamed: accepted old words and the words that they stand for.
    """

    help: str
    panel: str | None = None
    metavar: str | None = None
    flag: str = ""
    words: tuple[str, ...] = ()
    offered: tuple[str, ...] = ()
    whole: tuple[int, int | None] | None = None
    limits: tuple[float, float] | None = None
    unit: str = ""
    renamed: tuple[tuple[str, str], ...] = ()

    def unpanelled(self) -> CommandOption:
        """Return the same option for a command without panels."""
        return dataclasses.replace(self, panel=None)

    def described(self, text: str) -> CommandOption:
        """Return the same option with another help text, for a command without panels."""
        return dataclasses.replace(self, help=text, panel=None)

    def flag_of(self, field: str) -> str:
        """Return the option as typed, for a field of this name."""
        return self.flag or f"--{field.replace('_', '-')}"

    def check(self, field: str, value: Any) -> None:
        """Check a value against words and limits; None is an option left out.

        Raises UsageError with one line.
        """
        if value is None:
            return
        if self.words and value not in self.words:
            raise UsageError(f"{self.flag_of(field)} {value}: want one of {', '.join(self.words)}")
        if self.limits is not None and not self.limits[0] <= value <= self.limits[1]:
            low, high = self.limits
            raise UsageError(f"{self.flag_of(field)} {value:g}: want {low:g} to {high:g} {self.unit}")


def command_options(options: type[Any]) -> dict[str, CommandOption]:
    """Return the metadata of each field of an options class, in the order of its fields."""
    hints = get_type_hints(options, include_extras=True)
    return {field.name: hints[field.name].__metadata__[0] for field in dataclasses.fields(options)}


def check_fields(options: Any) -> None:
    """Check each field against words and limits of its option. Raises UsageError."""
    for name, option in command_options(type(options)).items():
        option.check(name, getattr(options, name))

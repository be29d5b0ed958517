"""How a command ends: with its exit code, or with one line that a person can act on."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, cast

import typer

from uav_recon.errors import EXIT_USAGE, UserError

EXIT_INTERRUPTED = 130
ParserError: type[Exception] = cast(Any, typer.BadParameter).__bases__[0]  # click's UsageError, or typer's own: it has moved


def exit_with(work: Callable[[], Any]) -> None:
    """Do the work and end with the code it gives; a Failure becomes its line and its code."""
    try:
        code = work()
    except UserError as failure:
        print(f"uav-recon: {failure}", file=sys.stderr)
        raise typer.Exit(failure.code) from None
    except KeyboardInterrupt:
        print("uav-recon: interrupted", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    raise typer.Exit(code or 0)


def end(app: typer.Typer) -> None:
    """Run the command line and end; what the parser refuses is one line too. Raises SystemExit."""
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except ParserError as error:
        told: Any = error
        if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
            told.show()
        else:
            print(f"uav-recon: {_plainly(told)}", file=sys.stderr)
    except typer.Abort:
        print("uav-recon: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
    sys.exit(EXIT_USAGE)


def _plainly(error: Any) -> str:
    """An option out of its range: its name, what was given, and the range. Anything else in the parser's own words."""
    option: Any = getattr(error, "param", None)
    names = getattr(option, "opts", [])
    given = _given(names) if isinstance(error, typer.BadParameter) else None
    said = " ".join(error.format_message().split())
    if given is None:
        return said[0].lower() + said[1:]
    kind = option if hasattr(option, "min") else option.type
    low, high = getattr(kind, "min", None), getattr(kind, "max", None)
    if low is None:
        return f"{names[-1]} {given}: {said.partition(': ')[2].lower() or said}"
    return f"{names[-1]} {given}: want {f'{low} or more' if high is None else f'{low} to {high}'}"


def _given(names: list[str]) -> str | None:
    """What the command line says for an option, None if nothing."""
    for word, following in zip(sys.argv[1:], [*sys.argv[2:], ""], strict=True):
        name, equals, value = word.partition("=")
        if name in names:
            return value if equals else following
    return None

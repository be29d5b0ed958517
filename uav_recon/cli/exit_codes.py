"""The end of a command: an exit code, or one line on standard error.

The line names something that a person can act on.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable
from typing import Any, cast

import typer

from uav_recon.errors import EXIT_FAILURE, EXIT_USAGE, UserError

EXIT_INTERRUPTED = 130
ParserError: type[Exception] = cast(Any, typer.BadParameter).__bases__[0]  # click's UsageError, or typer's newer class


def exit_with(work: Callable[[], Any]) -> None:
    """Run the work and exit with the code it returns.

    A UserError is printed and gives its own code, so is a file that the system refuses.
    """
    try:
        code = work()
    except UserError as failure:
        print(f"uav-recon: {failure}", file=sys.stderr)
        raise typer.Exit(failure.code) from None
    except OSError as failure:
        if not isinstance(failure, PermissionError) and failure.errno != errno.ENOSPC:
            raise
        print(f"uav-recon: {failure.filename or 'a file'}: cannot be read or written ({failure.strerror})", file=sys.stderr)
        raise typer.Exit(EXIT_FAILURE) from None
    except KeyboardInterrupt:
        print("uav-recon: interrupted", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    raise typer.Exit(code or 0)


def end(app: typer.Typer) -> None:
    """Run the command line and exit; an error of the parser is printed as one line.

    Raises SystemExit.
    """
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except ParserError as error:
        refused: Any = error
        if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
            refused.show()
        else:
            print(f"uav-recon: {_one_line(refused)}", file=sys.stderr)
    except typer.Abort:
        print("uav-recon: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
    sys.exit(EXIT_USAGE)


def _one_line(error: Any) -> str:
    """Return a parser error as one line.

    It is option, value and allowed range where a value is out of range, else the parser's own message.
    """
    option: Any = getattr(error, "param", None)
    names = getattr(option, "opts", [])
    given = _given(names) if isinstance(error, typer.BadParameter) else None
    message = " ".join(error.format_message().split())
    if given is None:
        return message[0].lower() + message[1:]
    kind = option if hasattr(option, "min") else option.type
    low, high = getattr(kind, "min", None), getattr(kind, "max", None)
    if low is None:
        return f"{names[-1]} {given}: {message.partition(': ')[2].lower() or message}"
    whole = "" if isinstance(low, float) or given.lstrip("+-").isdecimal() else "a whole number, "
    return f"{names[-1]} {given}: want {whole}{f'{low} or more' if high is None else f'{low} to {high}'}"


def _given(names: list[str]) -> str | None:
    """Return the value that the command line gives for an option, None if it gives none."""
    for word, following in zip(sys.argv[1:], [*sys.argv[2:], ""], strict=True):
        name, equals, value = word.partition("=")
        if name in names:
            return value if equals else following
    return None

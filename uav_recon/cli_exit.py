"""How a command ends: with its exit code, or with one line that a person can act on."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import typer

from uav_recon import run

EXIT_INTERRUPTED = 130


def exit_with(work: Callable[[], Any]) -> None:
    """Do the work and end with the code it gives; a Failure becomes its line and its code."""
    try:
        code = work()
    except run.Failure as failure:
        print(f"uav-recon: {failure}", file=sys.stderr)
        raise typer.Exit(failure.code) from None
    except KeyboardInterrupt:
        print("uav-recon: interrupted", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    raise typer.Exit(code or 0)

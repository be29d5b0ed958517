"""The command line itself: what each option lets through, and how it says no."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from uav_recon.cli import app


def callbacks(group: typer.Typer) -> Iterator[Callable[..., Any]]:
    for command in group.registered_commands:
        assert command.callback is not None
        yield command.callback
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from callbacks(inner.typer_instance)


@pytest.mark.parametrize("command", list(callbacks(app)), ids=lambda command: command.__qualname__)
def test_a_path_is_judged_by_who_opens_it(command: Callable[..., Any]) -> None:
    """Not by the parser, whose word is five lines and exit code 2: systemd would start the pilot again for ever."""
    for name, hint in typing.get_type_hints(command, include_extras=True).items():
        if name != "return":
            kind, said = typing.get_args(hint)
            assert not said.exists, name
            assert not (said.readable and Path in (kind, *typing.get_args(kind))), name

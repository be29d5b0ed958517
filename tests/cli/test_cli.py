"""Command line: values that each option accepts, and the errors for others."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.main import app, main


def callbacks(group: typer.Typer) -> Iterator[Callable[..., Any]]:
    for command in group.registered_commands:
        assert command.callback is not None
        yield command.callback
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from callbacks(inner.typer_instance)


@pytest.mark.parametrize("command", list(callbacks(app)), ids=lambda command: command.__qualname__)
def test_paths_are_checked_by_the_code_that_opens_them_and_not_by_the_parser(command: Callable[..., Any]) -> None:
    """The parser would print five lines and exit with code 2.

    systemd would then restart the pilot for ever.
    """
    for name, hint in typing.get_type_hints(command, include_extras=True).items():
        if name != "return":
            kind, said = typing.get_args(hint)
            assert not said.exists, name
            assert not (said.readable and Path in (kind, *typing.get_args(kind))), name


def test_an_interrupt_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise KeyboardInterrupt

    with pytest.raises(typer.Exit) as ended:
        exit_with(work)
    assert ended.value.exit_code == 130
    assert capsys.readouterr().err == "uav-recon: interrupted\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("sim --views 3", "--views 3: want 4 to 5000"),
        ("sim --views=5001", "--views 5001: want 4 to 5000"),
        ("sim --views many", "--views many: want 4 to 5000"),
        ("sim --seed -1", "--seed -1: want 0 or more"),
        ("faults --jobs 257", "--jobs 257: want 1 to 256"),
        ("sim --radius wide", "--radius wide: "),
        ("sim --nope", "no such option: --nope"),
        ("review", "missing argument"),
        ("fly", "no such command"),
    ],
)
def test_a_parser_error_is_one_line(
    words: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["uav-recon", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert ended.value.code == 2
    assert told.out == ""
    assert told.err.startswith(f"uav-recon: {said}"), told.err
    assert len(told.err.splitlines()) == 1


@pytest.mark.parametrize(("words", "code"), [("--help", 0), ("sim --help", 0), ("", 2), ("review /nowhere", 2)])
def test_help_and_other_errors_keep_their_exit_codes(
    words: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["uav-recon", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    told = capsys.readouterr()
    assert "Usage" in told.out + told.err or words.startswith("review")

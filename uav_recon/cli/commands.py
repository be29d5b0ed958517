"""The command group, and the function that adds a command to it.

The help text is the docstring, with examples below the options.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import typer
from typer.core import TyperGroup

from uav_recon.cli.exit_codes import ParserError

HELP_NAMES = {"help_option_names": ["-h", "--help"]}


class Commands(TyperGroup):
    """Command group that rejects empty words.

    An empty word comes from a shell variable that is not set, and would stand for the current folder.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line. Raises ParserError for an empty option value or argument."""
        for before, word in zip(["", *args], args, strict=False):
            name, equals, value = word.partition("=")
            if equals and name.startswith("--") and not value.strip():
                raise ParserError(f"{name} is empty: want a value")
            if not word.strip():
                raise ParserError(f"{before if before.startswith('-') else 'an argument'} is empty: want a value")
        return list(super().parse_args(ctx, args))


def new_group(text: str) -> typer.Typer:
    """Return a group of commands that prints its help when called alone."""
    return typer.Typer(no_args_is_help=True, rich_markup_mode="rich", context_settings=HELP_NAMES, help=_escaped(text))


def add(
    group: typer.Typer, callback: Callable[..., Any], name: str, panel: str | None = None, examples: Sequence[str] = (),
    hidden: bool = False,
) -> None:  # fmt: skip
    """Add a command.

    Its help is the docstring, one line a paragraph; examples are printed below the options.
    """
    paragraphs = inspect.cleandoc(callback.__doc__ or "").split("\n\n")
    text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    shown = "\n".join(("Examples:", *(f"  {example}" for example in examples))) if examples else None
    group.command(
        name, help=_escaped(text), epilog=shown and _escaped(shown), rich_help_panel=panel, hidden=hidden,
        context_settings=HELP_NAMES,
    )(callback)  # fmt: skip


def _escaped(text: str) -> str:
    """Escape square brackets, which rich would read as markup."""
    return text.replace("[", "\\[")

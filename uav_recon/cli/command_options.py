"""Commands made of one dataclass: its fields give signature, help and completion."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from sitl.apps.command_option import CommandOption, command_options
from sitl.apps.sim_options import CAMERA_ERRORS
from uav_recon.cli import choices
from uav_recon.cli.exit_codes import exit_with

Options = TypeVar("Options")


def command_of(options: type[Options], run: Callable[[Options], int]) -> Callable[..., None]:
    """Return the function that typer makes a command of.

    It has the fields of ``options`` as parameters and the docstring of ``run``, and exits with the code that ``run`` returns.
    """
    described, kinds = command_options(options), get_type_hints(options)

    def callback(**given: Any) -> None:
        current = {name: dict(described[name].renamed).get(value, value) for name, value in given.items()}
        exit_with(lambda: run(options(**current)))

    parameters = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default,
            annotation=Annotated[kinds[field.name], typer_option(described[field.name], field.name)],
        )
        for field in dataclasses.fields(options)  # type: ignore[arg-type]  # a type variable cannot be bound to dataclasses
    ]  # fmt: skip
    callback.__doc__ = run.__doc__
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    callback.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # read by inspect.signature
    return callback


def typer_option(option: CommandOption, field: str = "") -> Any:
    """Return the option for typer; field: its name, "" for the name of the parameter."""
    offered = option.words or option.offered
    low, high = option.whole or (None, None)
    return typer.Option(
        *([option.flag_of(field)] if field else []),
        help=option.help, rich_help_panel=option.panel, metavar=option.metavar or choices.listed(option.words) or None,
        autocompletion=choices.one_of(offered) if offered else None, min=low, max=high, readable=False,
    )  # fmt: skip


CameraErrorsOption = Annotated[str | None, typer_option(CAMERA_ERRORS.unpanelled())]

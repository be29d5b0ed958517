"""`uav-recon config ...`: write a commented config, check one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli.commands import add, new_group
from uav_recon.cli.exit_codes import exit_with


def write(
    file: Annotated[Path, typer.Argument(metavar="FILE", readable=False, help="File to write; - prints to the terminal.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a config with every key, its default and its meaning.

    Keys with a default are commented out. The keys of [safety] have none: enter your own numbers, then run
    `uav-recon config check FILE`.
    """
    from uav_recon.app import config_template

    exit_with(lambda: config_template.write(file, force))


def check(file: Annotated[Path, typer.Argument(metavar="FILE", readable=False, help="A TOML config.")]) -> None:
    """Check a config. Exit code 0: valid; 78: not valid (reason printed)."""
    from uav_recon.app import config_template

    exit_with(lambda: config_template.check(file))


config = new_group("Write a commented config, or check one.")
add(config, write, "write", examples=("uav-recon config write config.toml", "uav-recon config write - | less"))
add(config, check, "check", examples=("uav-recon config check /etc/uav_recon/config.toml",))

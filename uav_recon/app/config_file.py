"""Config file of a process, its errors as those of the user."""

from __future__ import annotations

from pathlib import Path

from uav_recon import config as configuration
from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, UserError


def load_config(path: Path) -> Config:
    """Read a config. Raises UserError with exit code 78."""
    try:
        return configuration.load(path)
    except configuration.ConfigError as error:
        raise UserError(str(error), EXIT_CONFIG) from None

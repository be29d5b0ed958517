"""Errors that a user can correct: one line and an exit code."""

from __future__ import annotations

EXIT_FAILURE = 1
EXIT_USAGE = 2
EXIT_SECOND_COPY = 75
EXIT_CONFIG = 78


class UserError(Exception):
    """An error that a user can correct, in one line; code is the exit code."""

    code = EXIT_FAILURE

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = self.code if code is None else code

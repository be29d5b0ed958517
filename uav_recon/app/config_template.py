"""Template of a config file, made from the config tree, and the check of a config file.

The template holds every key with its default and its meaning.
"""

from __future__ import annotations

import inspect
import io
import sys
import tokenize
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from uav_recon.app import config_file
from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.config import Config, replace_text
from uav_recon.errors import UserError

HEAD = """\
# Configuration of uav_recon, every key with its default. A key that is commented out has the value shown.
# An unknown key is an error. Check the file: uav-recon config check FILE
# [safety] has no defaults: remove the # and enter your own numbers (systemd/config.toml is an example).
"""
STANDARD_OUTPUT = Path("-")


def write(path: Path, force: bool) -> int:
    """Write the commented config, to standard output for `-`; returns the exit code.

    Raises UsageError, or UserError if there is no space.
    """
    if path == STANDARD_OUTPUT:
        sys.stdout.write(text())
        return 0
    require_writable_file("FILE", path)
    if path.exists() and not force:
        raise UsageError(f"FILE {path}: exists already; --force replaces it")
    try:
        replace_text(path, text())
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from None
    print(f"{path}: written. Enter the numbers of [safety], then run: uav-recon config check {path}")
    return 0


def check(path: Path) -> int:
    """Load a config and print that it is valid; returns the exit code.

    Raises UserError with exit code 78.
    """
    config_file.load_config(path)
    print(f"{path}: valid")
    return 0


def text() -> str:
    """Return the commented config as TOML.

    It can be parsed. Every key in it is commented out.
    """
    sections = [HEAD]
    for name, section in Config.model_fields.items():
        model = section.annotation
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            raise TypeError(name)
        sections.append("\n".join((*_comment(model.__doc__ or ""), f"[{name}]", *_lines(model))) + "\n")
    return "\n".join(sections)


def _lines(model: type[BaseModel]) -> list[str]:
    words = meanings(model)
    return [
        f"# {key} = {_value(field)}   # {'; '.join(filter(None, (words.get(key), _allowed(field))))}"
        for key, field in model.model_fields.items()
    ]


def _value(field: FieldInfo) -> str:
    """Return the default as TOML; a placeholder for a key without a default."""
    if field.is_required():
        return "REQUIRED"
    default: Any = field.default
    if default is None:
        return "UNSET"
    shown = str(default) if isinstance(default, Path) else list(default) if isinstance(default, tuple) else default
    words = tomli_w.dumps({"v": shown}).strip().removeprefix("v = ")
    return " ".join(words.split()).replace("[ ", "[").replace(", ]", "]")


def _allowed(field: FieldInfo) -> str:
    """Return the allowed range or words of a key; "" if its type is enough."""
    if get_origin(field.annotation) is Literal:
        return "one of " + ", ".join(map(str, get_args(field.annotation)))
    words = [
        f"{word} {limit:g}"
        for bound, word in (("ge", "at least"), ("gt", "more than"), ("le", "at most"), ("lt", "less than"))
        for limit in (getattr(one, bound, None) for one in field.metadata)
        if limit is not None
    ]
    return ", ".join(words)


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the comment behind each field in the source."""
    found: dict[str, str] = {}
    name = ""
    for token in tokenize.generate_tokens(io.StringIO(inspect.getsource(model)).readline):
        if token.type == tokenize.NAME and token.string in model.model_fields and token.start[1] == 4:
            name = token.string
        elif token.type == tokenize.COMMENT and name:
            found[name] = token.string.lstrip("# ")
        elif token.type == tokenize.NEWLINE:
            name = ""
    return found


def _comment(words: str) -> list[str]:
    return [f"# {line}".rstrip() for line in inspect.cleandoc(words).splitlines()]

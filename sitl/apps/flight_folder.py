"""The folder and the files of a flight in simulation, checked before its work begins."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from pathlib import Path

from uav_recon.app.option_validation import OUTPUTS, UsageError, readable, require_writable_folder


def dated_folder(scene: str | None) -> Path:
    """Return the folder flights/SCENE-DATE of a flight that begins now; it is not made."""
    stem = "room" if scene is None else Path(scene).stem.replace(":", "-")
    return (Path("flights") / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}").absolute()


def check_folder(folder: Path) -> None:
    """Check a flight folder before the work.

    Raises UsageError if it cannot be made or already contains a file that a flight would replace.
    """
    with readable(f"--out {folder}"):
        if taken := next((name for name in OUTPUTS if (folder / name).exists()), None):
            raise UsageError(f"--out {folder}: already contains {taken}; name another folder")
        there = next(place for place in (folder, *folder.parents) if place.exists())
        if not there.is_dir():
            raise UsageError(f"--out {folder}: cannot be written ({there} is not a folder)")
        if not os.access(there, os.W_OK | os.X_OK):
            raise UsageError(f"--out {folder}: cannot be written ({there}: permission denied)")


def make_own_folder(dated: Path) -> Path:
    """Make a dated folder that no other process uses, with a number behind the date if needed.

    Raises UsageError if it cannot be made.
    """
    check_folder(dated)
    for number in itertools.count(1):
        folder = dated if number == 1 else dated.with_name(f"{dated.name}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise UsageError(f"--out {folder}: cannot be written ({error.strerror})") from None
        return folder
    raise AssertionError


def make_folder(folder: Path) -> None:
    """Make the flight folder and its folder of logs.

    Raises UsageError; see check_folder.
    """
    check_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "logs").mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder}: cannot be written ({error.strerror})") from None


def check_kept_file(option: str, file: Path | None, is_one: Callable[[Path], bool], what: str) -> None:
    """Check a file that one flight leaves to the next, before the flight. It need not exist.

    is_one: whether a file is of this kind, which ``what`` names. Raises UserError with exit code 2.
    """
    if file is None:
        return
    with readable(f"{option} {file}"):
        if file.is_dir():
            raise UsageError(f"{option} {file}: is a folder")
        if not file.parent.is_dir():
            raise UsageError(f"{option} {file}: folder {file.parent} does not exist")
        if file.exists() and not (file.is_file() and is_one(file)):
            raise UsageError(f"{option} {file}: not {what}")
    require_writable_folder(option, file.parent)


def check_program(firmware: Path | None) -> None:
    """Check a firmware binary. Raises UsageError if it cannot be started."""
    if firmware is None:
        return
    with readable(f"--firmware {firmware}"):
        folder, there = firmware.is_dir(), firmware.is_file()
    if not there:
        raise UsageError(f"--firmware {firmware}: {'is a folder; want the binary in it' if folder else 'no such file'}")
    if not os.access(firmware, os.X_OK):
        raise UsageError(f"--firmware {firmware}: not executable")

"""Check that a file is replaced as a whole: by failure, by mode, and by what is synced."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from uav_recon import atomic_file


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "file").write_bytes(b"old")
    return tmp_path / "file"


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Path, bytes]]:
    """Return what os.fsync was called with: the path, and the content of the file under its own name at that moment."""
    calls: list[tuple[Path, bytes]] = []

    def note(descriptor: int) -> None:
        place = Path(f"/proc/self/fd/{descriptor}").readlink()
        named = place / "file" if place.is_dir() else place.with_name("file")
        assert place.is_dir() or place.read_bytes() == b"new", "synced before all was written"
        calls.append((place, named.read_bytes()))

    monkeypatch.setattr(os, "fsync", note)
    return calls


def test_the_old_content_stays_until_the_new_one_is_complete(path: Path) -> None:
    with atomic_file.writing(path, durable=False) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(path.parent.iterdir()) == [path]


def test_a_new_file_appears_with_its_content(tmp_path: Path) -> None:
    atomic_file.replace(tmp_path / "file", memoryview(b"new"), durable=True)
    assert (tmp_path / "file").read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), ValueError()], ids=repr)
def test_a_failure_while_writing_leaves_the_old_content_alone(path: Path, error: BaseException) -> None:
    def fail() -> None:
        with atomic_file.writing(path, durable=False) as file:
            file.write(b"ne")
            raise error

    with pytest.raises(type(error)) as raised:
        fail()
    assert raised.value is error
    assert path.read_bytes() == b"old"
    assert list(path.parent.iterdir()) == [path]


def test_a_full_disk_at_the_sync_leaves_the_old_content_alone(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device"):
        atomic_file.replace(path, b"new", durable=True)
    assert path.read_bytes() == b"old"
    assert list(path.parent.iterdir()) == [path]


def test_a_rename_that_fails_leaves_no_file_beside(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        atomic_file.replace(tmp_path / "folder", b"new", durable=False)
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]


def test_a_folder_that_is_missing_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        atomic_file.replace(tmp_path / "missing" / "file", b"new", durable=False)


def test_a_durable_file_is_synced_before_the_rename_and_its_folder_after_it(
    path: Path, synced: list[tuple[Path, bytes]]
) -> None:
    atomic_file.replace(path, b"new", durable=True)
    aside, folder = synced
    assert (aside[0].parent, aside[1]) == (path.parent, b"old")
    assert folder == (path.parent, b"new")


def test_a_file_that_is_not_durable_is_not_synced(path: Path, synced: list[tuple[Path, bytes]]) -> None:
    atomic_file.replace(path, b"new", durable=False)
    assert synced == []


def test_a_replaced_file_keeps_its_mode(path: Path) -> None:
    path.chmod(0o600)
    atomic_file.replace(path, b"new", durable=False)
    assert (path.read_bytes(), stat.S_IMODE(path.stat().st_mode)) == (b"new", 0o600)


def test_a_new_file_has_the_usual_mode(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        atomic_file.replace(tmp_path / "file", b"new", durable=False)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o644


def test_the_old_file_is_kept_under_another_name_only_if_the_new_one_is_complete(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    previous = path.with_name("previous")
    for content in (b"1", b"2"):
        with atomic_file.writing(path, durable=True, previous=previous) as file:
            file.write(content)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fail() -> None:
        with atomic_file.writing(path, durable=True, previous=previous) as file:
            file.write(b"3")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device"):
        fail()
    assert (path.read_bytes(), previous.read_bytes()) == (b"2", b"1")


def test_the_first_file_has_no_previous_one(tmp_path: Path) -> None:
    with atomic_file.writing(tmp_path / "file", durable=False, previous=tmp_path / "previous") as file:
        file.write(b"1")
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]

"""Check that the simulator's files are replaced as a whole."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sitl.runtime import atomic_file


def test_the_old_content_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with atomic_file.writing(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_the_old_content_alone(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def fail() -> None:
        with atomic_file.writing(path) as file:
            file.write(b"ne")
            raise ValueError

    with pytest.raises(ValueError):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_processes_write_aside_under_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    with atomic_file.writing(path) as file:
        file.write(b"first")
        monkeypatch.setattr(os, "getpid", lambda: -1)
        atomic_file.replace(path, b"second")
        assert path.read_bytes() == b"second"
    assert path.read_bytes() == b"first"

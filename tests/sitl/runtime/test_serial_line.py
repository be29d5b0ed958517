"""A serial line whose plug is pulled."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import pytest

from sitl.runtime.serial_line import SerialLine


def test_a_line_that_is_unplugged_is_gone_for_who_has_it_open_and_another_when_it_is_back(tmp_path: Path) -> None:
    name = tmp_path / "autopilot"
    with closing(SerialLine(name)) as line:
        assert line.read() == b"", "nobody has it open"
        line.write(b"lost")
        product = os.open(name, os.O_RDWR | os.O_NOCTTY)
        line.write(b"one\n")
        assert os.read(product, 64).endswith(b"one\n")
        line.unplug()
        assert not name.exists()
        with pytest.raises(OSError):
            os.write(product, b"x")
        os.close(product)
        assert line.read() == b""
        line.write(b"lost")
        line.plug()
        product = os.open(name, os.O_RDWR | os.O_NOCTTY)
        os.write(product, b"two\n")
        assert b"two" in line.read()
        os.close(product)
    assert not name.is_symlink()

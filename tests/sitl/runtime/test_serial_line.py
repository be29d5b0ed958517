"""Serial line that is unplugged and plugged in again."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import pytest

from sitl.runtime.serial_line import SerialLine


def test_an_unplugged_line_fails_for_its_user_and_is_a_new_device_when_plugged_in(tmp_path: Path) -> None:
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

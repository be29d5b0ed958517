"""Headers of JSON results: what they contain, and how a command is written down."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from uav_recon.errors import UserError
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import REFERENCE_S, MachineSpeed
from uav_recon.measurement.result_file import command_line, result_header

BUSY = MachineSpeed(4 * REFERENCE_S, 2 * REFERENCE_S)


def test_the_header_states_reference_time_and_contention_of_a_busy_machine() -> None:
    header = result_header(BUSY)
    assert (header.reference_job_s, header.contention) == (2 * REFERENCE_S, 2.0)
    assert header.commit + ("+changed" if header.changed else "") == host_info.commit()
    assert header.date.endswith("Z")
    assert header.seconds > 0.0
    assert header.memory_gib > 0.0


def test_a_command_line_contains_no_path_of_this_machine() -> None:
    here = Path("/home/somebody/uav_recon")
    words = ["/venv/bin/uav-recon", "sim", "--json", "/home/somebody/uav_recon/results/a b.json", "--firmware", "/opt/px4"]
    assert command_line(words, here) == "uav-recon sim --json 'results/a b.json' --firmware px4"
    assert command_line(["/x/uav_recon/__main__.py", "sweep"], here) == "uav-recon sweep"
    assert command_line(["tests/safety/hostile_proposals.py", "9"], here) == "python tests/safety/hostile_proposals.py 9"


def test_values_follow_the_header_and_numbers_that_are_not_finite_become_null(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    result_file.save(path, {"a": [math.nan, np.float64(2.0)], "b": {"c": (math.inf, 1)}}, result_header(BUSY))
    tree = json.loads(path.read_text(encoding="utf-8"))
    assert list(tree) == ["header", "a", "b"]
    assert tree["a"] == [None, 2.0]
    assert tree["b"] == {"c": [None, 1]}


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be written"):
        result_file.save(tmp_path / "missing" / "x.json", {}, result_header(BUSY))


def test_a_value_that_cannot_be_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    report = {"views": 120, "time_to_recall_s": {"0.90": 119.4}, "flight_time_s": 168.5}
    with pytest.raises(UserError, match=r"report/views: 120; allowed 0 to 60 \(the budget of views\); not written"):
        result_file.save(path, {"view_budget": 60, "report": report}, result_header(BUSY))
    assert not path.exists()

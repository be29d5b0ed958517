"""A mistyped number on the command line is a one-line error with exit code 2.

It is reported before anything is loaded.
"""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from uav_recon.cli.main import app


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("bench mapper --views 100000", "--views 100000: want 4 to 2000"),
        ("bench mapper --steps-per-view 100000", "--steps-per-view 100000: want 1 to 200"),
        ("bench mapper --exposure 1e9", "--exposure 1e+09: want 0 to 2"),
        ("bench mapper --pose-noise 1e9,0", "--pose-noise 1e9,0: want CM,DEG, 0 or more and at most 10 and 5"),
        ("bench endurance --views 100000", "--views 100000: want 4 to 2000"),
        ("bench endurance --hours 1e9", "--hours 1e+09 --period-s 1.5: want "),
        ("bench uncertainty --after 20,100000", "--after 20,100000: want numbers of views with commas between them, 1 to 2000"),
        ("bench setpoints --minutes 1e9", "--minutes 1e+09: want 0.1 to 120"),
        ("sweep --jobs 250", "--jobs 250: want 1 to "),
        ("faults --jobs 250", "--jobs 250: want 1 to "),
        (
            "sim --fence=-99,-99,-1,99,99,9",
            "built-in: a fence of (198.00, 198.00, 10.00) m holds 392040 m3; want at most 30000",
        ),
    ],
)
def test_a_mistyped_number_is_a_one_line_error(words: str, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.apps.sim_options.memory_gb", lambda: 16.0)
    ended = CliRunner().invoke(app, words.split())
    assert ended.exit_code == 2, ended.output
    assert ended.stderr.startswith(f"uav-recon: {line}")
    assert len(ended.stderr.splitlines()) == 1
    progress = ("loading the scene: ", "compiling kernels ")  # on a busy machine, or before the first flight
    assert all(shown.startswith(progress) for shown in ended.stdout.splitlines()), ended.stdout

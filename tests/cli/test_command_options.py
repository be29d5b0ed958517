"""Commands whose options are the fields of a dataclass: typed, described and checked once."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from sitl.apps.sim_options import SimOptions
from sitl.apps.sweep_options import SweepOptions
from sitl.faults.flights.fault_options import FaultOptions
from uav_recon.cli.command_options import command_of
from uav_recon.cli.commands import add


@pytest.mark.parametrize("options", [SimOptions, SweepOptions, FaultOptions])
def test_a_command_has_the_fields_and_defaults_of_its_options(options: type[Any]) -> None:
    given: list[Any] = []

    def run(made: Any) -> int:
        given.append(made)
        return 0

    command = command_of(options, run)
    shown = {name: parameter.default for name, parameter in inspect.signature(command).parameters.items()}
    assert shown == {field.name: field.default for field in dataclasses.fields(options)}
    assert CliRunner().invoke(_group(command), ["fly"]).exit_code == 0
    assert given == [options()]


def test_typed_values_reach_the_options_by_their_flags() -> None:
    given: list[SimOptions] = []

    def run(made: SimOptions) -> int:
        given.append(made)
        return 7

    words = "fly --radius 0.3 --blind-speed 1.2 --range-up 27 --mapper stand-in --lockstep --views 8 --camera-errors none"
    done = CliRunner().invoke(_group(command_of(SimOptions, run)), words.split())
    assert done.exit_code == 7, done.output
    assert given == [
        SimOptions(
            radius_m=0.3, blind_speed_mps=1.2, range_up_deg=27.0, mapper="depth-only", lockstep=True, views=8,
            camera_errors="none",
        )
    ]  # fmt: skip


def test_options_that_cannot_be_used_together_are_one_line_with_exit_code_2() -> None:
    done = CliRunner().invoke(_group(command_of(SimOptions, lambda _: 0)), ["fly", "--mapper", "stand-in"])
    assert (done.exit_code, done.stderr) == (2, "uav-recon: --mapper depth-only: needs --lockstep\n")


def _group(command: Any) -> typer.Typer:
    group = typer.Typer()
    group.callback()(lambda: None)
    add(group, command, "fly")
    return group

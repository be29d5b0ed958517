"""Options of the commands that read a recording."""

from __future__ import annotations

from typing import Annotated

import typer

FORMAT = "Format"
DEPTH_UNIT_HELP = (
    "Metres per unit of the depth images, 0.00001 to 1: 0.001 is millimetres, 0.00025 an L515, 0.0001 a D405. Default: as the "
    "format has it."
)
DepthUnitOption = Annotated[float | None, typer.Option("--depth-unit", metavar="M", help=DEPTH_UNIT_HELP)]
FormatDepthUnitOption = Annotated[
    float | None, typer.Option("--depth-unit", metavar="M", rich_help_panel=FORMAT, help=DEPTH_UNIT_HELP)
]

"""All scenarios, in the order of the list of hazards, and their names on the command line."""

from __future__ import annotations

import itertools

from sitl.faults.soak import SOAKS
from sitl.faults.table.authority_geometry_host import TABLE_E, TABLE_F, TABLE_G
from sitl.faults.table.camera_and_link import TABLE_C, TABLE_D
from sitl.faults.table.pairs import PAIRED, pair
from sitl.faults.table.pose_source import TABLE_B
from sitl.faults.table.position_measurements import TABLE_H
from sitl.faults.table.scenario import Scenario
from sitl.faults.table.software import TABLE_A

TABLE: tuple[Scenario, ...] = (*TABLE_A, *TABLE_B, *TABLE_C, *TABLE_D, *TABLE_E, *TABLE_F, *TABLE_G, *TABLE_H)
_PAIRED = [scenario for scenario in TABLE if scenario.id in PAIRED]
PAIRS: tuple[Scenario, ...] = tuple(pair(first, second) for first, second in itertools.combinations(_PAIRED, 2))
SCENARIOS = {scenario.id: scenario for scenario in (*TABLE, *SOAKS, *PAIRS)}
NAMED = {**{name: (scenario,) for name, scenario in SCENARIOS.items()}, "G9": SOAKS[:1], "G10": PAIRS}

"""All rows, in the order of the hazards' list."""

from __future__ import annotations

from sitl.faults.row import Row
from sitl.faults.table_ab import TABLE_A, TABLE_B
from sitl.faults.table_cd import TABLE_C, TABLE_D
from sitl.faults.table_efg import TABLE_E, TABLE_F, TABLE_G

TABLE: tuple[Row, ...] = (*TABLE_A, *TABLE_B, *TABLE_C, *TABLE_D, *TABLE_E, *TABLE_F, *TABLE_G)
ROWS = {row.id: row for row in TABLE}

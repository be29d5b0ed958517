"""Copy a row into a table, inside a kernel.

`table[n] = row` broadcasts in numba. The message of its error alone takes seconds to compile, once in each process, and each
assignment becomes hundreds of lines of intermediate code.
"""

from __future__ import annotations

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray


@kernel
def copy_row(table: AnyArray, n: int, row: AnyArray) -> None:
    """Write row (K,) into table[n] (N, K)."""
    for k in range(len(row)):
        table[n, k] = row[k]

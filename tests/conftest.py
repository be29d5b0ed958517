"""Where tests run side by side, each process keeps to one core: two that compute on both would get in each other's way."""

from __future__ import annotations

import os

from sitl.fly_case import one_thread

if "PYTEST_XDIST_WORKER" in os.environ:
    one_thread()

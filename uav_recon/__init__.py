"""uav_recon: an unknown room in, a watertight, coloured, metric model out, flown without a pilot and without GPS."""

import os

# Before numpy is loaded: with huge pages the first touch of a large map's page stalls a frame for 6 to 50 ms.
os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")

"""uav_recon: an unknown room in, a watertight, coloured, metric model out, flown without a pilot and without GPS."""

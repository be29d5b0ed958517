"""The mapper benchmark: accuracy, speed and uncertainty against a TSDF."""

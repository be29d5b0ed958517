"""Return home: path to the pad, and the landing site."""

"""Where the drone is: pose sources and the filter that carries them to a steady odometry."""

"""The mapper as a process: the child that learns, what it leaves on disk, and the handle that the mission holds."""

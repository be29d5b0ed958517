"""A real firmware binary in the simulated autopilot's place: started, listened to, and followed by camera, poses and judge."""

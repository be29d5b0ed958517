"""The simulator: scene, vehicle, camera and autopilot. Not part of the flight software."""

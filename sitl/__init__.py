"""The outside world for tests: scene, vehicle, camera, autopilot. Nothing here is in the product."""

"""The pilot loop: setpoints through the guard, take-off, landing, failsafe, pose feed."""

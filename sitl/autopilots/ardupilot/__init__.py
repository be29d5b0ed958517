"""The simulated ArduCopter."""

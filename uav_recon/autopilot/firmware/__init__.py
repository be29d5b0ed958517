"""Firmware profiles: what differs between PX4 and ArduCopter."""

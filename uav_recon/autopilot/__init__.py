"""Autopilot: the only code that speaks MAVLink, with firmware profiles, link and pilot."""

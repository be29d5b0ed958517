"""The only code that speaks MAVLink: codec, firmware personalities, link and pilot."""

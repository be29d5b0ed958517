"""Pure metrics of a reconstruction against truth."""

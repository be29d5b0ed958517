"""The operator's word: a local socket at the pilot, and the command that speaks to it."""

"""Publication of the intent, the maps and the progress."""

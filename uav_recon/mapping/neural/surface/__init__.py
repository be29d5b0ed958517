"""Where the field says that surface is, and how sure it may be of it."""

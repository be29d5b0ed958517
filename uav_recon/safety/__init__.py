"""The last hop: fence, limits and the guard that denies by default. Imports types only."""

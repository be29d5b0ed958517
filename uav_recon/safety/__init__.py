"""Safety: fence, limits, and the guard, which denies by default. Imports types only."""

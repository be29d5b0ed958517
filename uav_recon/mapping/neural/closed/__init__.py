"""The final model: a closed surface with its texture, and the files that hold it."""

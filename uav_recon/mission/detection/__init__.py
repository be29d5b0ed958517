"""Detection: the events of a step, and trouble that needs a response in the same step."""

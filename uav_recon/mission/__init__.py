"""Mission: events, a pure state machine, and the conductor that runs the stages in order."""

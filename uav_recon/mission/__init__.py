"""Events, a pure state machine, and the conductor that gives the stages their order."""

"""The command line: parse the options, call the composition roots, end with an exit code."""

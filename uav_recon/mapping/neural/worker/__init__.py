"""The mapper in its own process: client, child process, watchdog, checkpoints."""

"""One run, in one process or as a fleet of processes."""

"""Programs of others as agents, unchanged: real processes in simulated time."""

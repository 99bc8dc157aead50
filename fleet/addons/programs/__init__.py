"""Programs of others as agents in lockstep, unchanged: real processes in simulated time, or Python on stand-ins."""

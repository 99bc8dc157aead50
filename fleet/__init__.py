"""The operator: scenarios, launch and supervision, the clock, the log and the command line."""

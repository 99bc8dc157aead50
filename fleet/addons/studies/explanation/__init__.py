"""`fleet why`: explains a failed check by its log, and finds the last moment when healing would have saved it."""

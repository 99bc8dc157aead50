"""`fleet why`: a failed check explained by its log, and the last moment at which healing would have saved the run."""

"""Studies: many runs of one scenario, their results, and how sure these are."""

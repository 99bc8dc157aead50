"""Studies: many runs of one scenario, what they come to, and how sure that is."""

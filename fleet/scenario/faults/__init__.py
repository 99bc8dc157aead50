"""The kinds of faults, each with all that is known of it."""

"""A scenario: read, checked, and compiled into the configuration of each core."""

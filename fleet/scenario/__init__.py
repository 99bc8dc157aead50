"""A scenario: read, checked, and compiled into what each core is told."""

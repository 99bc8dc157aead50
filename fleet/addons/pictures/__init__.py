"""Pictures and the report of one or several runs."""

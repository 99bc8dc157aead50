"""Pictures and the report of a study."""

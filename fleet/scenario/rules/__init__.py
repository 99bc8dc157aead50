"""Rules between the sections of a scenario; every mistake is reported, not only the first."""

"""The wire protocol as a page, and the test that somebody else's agent speaks it."""

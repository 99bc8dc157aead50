"""The wire protocol as a page, and the test that a foreign agent follows it."""

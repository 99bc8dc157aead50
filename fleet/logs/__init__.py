"""Logs of runs as messages, arrays and tables: topics and their schemas, differences, exports."""

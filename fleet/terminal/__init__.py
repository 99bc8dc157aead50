"""The terminal: output, one status line, and keys."""

"""Cost of the emulator: measurements that print a table."""

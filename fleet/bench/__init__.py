"""What the emulator costs: measurements that print a table."""

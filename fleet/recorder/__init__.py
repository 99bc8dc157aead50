"""What a run records: frames and fates in one order, measured, and written as MCAP."""

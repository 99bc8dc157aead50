"""Recording of a run: frames and fates in one order, measured, and written as MCAP."""

"""MCAP files of any origin: read whole or damaged, written, mended; and what is read as one in their place."""

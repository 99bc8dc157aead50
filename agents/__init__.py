"""The brains: consensus guidance, the online gain QP and the tracking controllers."""

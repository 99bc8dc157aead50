"""Learned protocols: a fleet as an environment of PettingZoo, with policies in place of laws."""

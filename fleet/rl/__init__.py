"""Learned protocols: a fleet as an environment of PettingZoo, in which policies decide what vehicles do and send."""

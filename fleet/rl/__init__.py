"""Learned protocols: a fleet as an environment of PettingZoo. Policies decide what vehicles do and send."""

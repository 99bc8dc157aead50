"""Checks of the user's own, on any signal or in Python: fed tick by tick, by a run that goes on or from its log."""

"""Your own checks, on any signal or in Python: fed tick by tick, by a live run or from its log."""

"""Robots that are not ours on our network: their relay as a run, with a log, an operator and a verdict."""

"""Somebody else's laws: found, allowed, checked and fenced in."""

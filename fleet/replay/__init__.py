"""Logs and zenoh: a log played again, a run's log published live, other traffic captured."""

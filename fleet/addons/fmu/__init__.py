"""Vehicles that are given as units of FMI 2 and 3."""

"""Zenoh and the messages on it: no other room imports zenoh."""

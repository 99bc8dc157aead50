"""Zenoh and the messages on it: no other room knows zenoh."""

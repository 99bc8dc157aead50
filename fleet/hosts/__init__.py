"""A run over several hosts: where its processes meet, with which certificates and rights."""

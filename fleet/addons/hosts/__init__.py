"""A run over several hosts: the address where its processes meet, their certificates and their rights."""

"""The meaning of each section: trajectories, links, laws and faults computed from its values."""

"""What each section means: trajectories, links, laws and faults computed from what it says."""

"""The network between robots whose programs are yours, and what ROS 2 sees of a run."""

"""A fleet that ROS 2 sees and takes part in, over zenoh as rmw_zenoh speaks it, and bags of it; without ROS."""

"""A node of ROS 2: a live session of what its topics say, and a server of maps."""

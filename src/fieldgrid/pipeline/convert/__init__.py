"""One standard MCAP of what was understood of a recording, for Foxglove and every tool of ROS 2.

Frames by REP-103 and REP-105: `map` is the Local Tangent Plane (east, north, up), `base_footprint`
the grid origin (forward, left, up), below it the optical frames of the sensor, the antenna, and
the axle that does not steer where it is known.
All stamps are by the clock of the receiver. Topics: images with their camera_info (or depths, or
points), /gnss/fix with /gnss/fix/details, /imu/data, /wheel_odometry, /pose, /tf, /tf_static with
/fieldgrid/rig, and /datum, where `map` is. What is read again gives the map of the original.
"""

"""Containers of ROS messages, of ROS 1 and ROS 2: read tolerantly and as a stream, and written.

`open_bag` opens a `.bag`, an `.mcap`, a `.db3` or a folder of these as one `Bag`, whatever state
its end is in. What writes is in `ros.writers`, which takes longer to import than all
that reads. What the messages mean is for others.
"""

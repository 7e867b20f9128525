"""Stereo visual odometry: how the vehicle moved from one pair of images to the next.

`features` does the heavy part, one frame at a time, and keeps no state, so that frames may be
prepared in worker threads; `step` is the light rest, for two frames in order. Both give the
same bits for the same images, in whatever thread they run.
"""

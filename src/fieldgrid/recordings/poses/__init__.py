"""Trajectories of other programs, as a recording gives them."""

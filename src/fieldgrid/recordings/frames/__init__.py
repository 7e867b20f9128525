"""Images, depths and point clouds in files, read when they are asked for."""

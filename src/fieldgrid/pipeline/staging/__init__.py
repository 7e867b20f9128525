"""The heavy half of a build: frames to staged frames, on all cores or a cluster."""

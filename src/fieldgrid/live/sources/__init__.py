"""Sources of a live session: receivers, cameras, folders, MCAP streams."""

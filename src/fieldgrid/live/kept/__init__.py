"""What a live session keeps on the disk, so that a kill loses nothing."""

"""What a build checks of a drive: images, clocks and mounting against the path."""

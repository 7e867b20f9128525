"""The frames of a bag: cameras, images, depths, clouds, and where they are mounted."""

"""What is in a recording, and what would go wrong with it."""

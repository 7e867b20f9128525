"""Forward or reverse: legs of a drive, and the likeliest gear of each."""

"""Reading a map: views, their blocks, their sources, and what cells count as."""

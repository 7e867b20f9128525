"""How the drives of a map lie against each other, and the transforms that make them coincide."""

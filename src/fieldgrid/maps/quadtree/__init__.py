"""A map in squares of several sizes: small where it changes, large where it does not.

A region quadtree (Samet 1984, https://doi.org/10.1145/356924.356930) of the cells of a map. Its
squares have sides of 1, 2, 4 ... 256 cells, and begin at multiples of their side from the datum.
The largest are looked at first. A square stays whole where all of its cells count as the same for a
planner, enough of them were seen, and none differs in density by more than a stated loss from
the mean; else it is split into squares of the next smaller side. With two sides it is a map of
dual resolution.
"""

"""A farm: a folder of maps, listed, and read as if they were one map.

A view over several maps has the bits of the map that `merge_maps` would make of them; nothing is
written, and maps are opened when a window touches them::

    farm = Farm("maps")
    for block in farm.blocks:
        print(block.name, block.area_m2, block.problem)
    view = farm.read(Bounds(0.0, 0.0, 20.0, 20.0), layers=["count"])
"""

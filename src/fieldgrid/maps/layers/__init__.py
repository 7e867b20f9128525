"""What a map says of its cells: channel groups, the layers made of them, and how they fold.

One module a built-in subject. A module of your own adds a layer with `register_group`, where it
needs channels that are not there, and `register_layer`; it is found when the entry points of its
package name it in the group `fieldgrid.layers`::

    register_layer(Layer("dense", "uint8", "", "1 above 200", ("density",), ..., None, colours))

Maps written from then on hold its channels at every zoom level; `MapFile.repair` adds them to
older maps, and until then a read folds them from the frames.
"""

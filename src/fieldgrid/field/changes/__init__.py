"""Changes between drives as objects: what appeared, vanished, moved, grew or was cut back.

Two good drives of one field differ at every edge. What counts as a change is what their
positions, their frames and the sides from which they looked cannot explain; `docs/changes.md` has
the definitions::

    for changed in find_changes(universal, "june-03", "june-17"):
        print(changed.kind, changed.area_m2, changed.east_m, changed.north_m, changed.confidence)
"""

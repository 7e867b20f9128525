// The cells of a map as tiles: a layer over some sessions, or what changed between two moments.

import ImageTile from "ol/source/ImageTile";
import TileGrid from "ol/tilegrid/TileGrid";
import type Projection from "ol/proj/Projection";

import type { MapAbout, Shown, Source } from "./data";
import { announce } from "./dom";
import { kinds, paint, table } from "./ramp";

const SIDE = 256;

/** The map's own tiles: level 0 has its cells, each level above cells of twice the side. */
export function tileGrid(map: MapAbout): TileGrid {
  const [west, south, east, north] = map.bounds ?? [-1, -1, 1, 1];
  const resolutions = Array.from({ length: map.levels + 1 }, (_, z) => map.cell_m * 2 ** (map.levels - z));
  // Tile (ty, tx) of a level begins tx tiles east and ty tiles north of the datum.
  return new TileGrid({ extent: [west, south, east, north], origin: [0, 0], resolutions, tileSize: SIDE });
}

/** A source of tiles in the colours of what they show. */
export function cellSource(data: Source, map: MapAbout, shown: Shown, projection: Projection): ImageTile {
  const colours = shown.between
    ? kinds(map.changes.map((kind) => kind.colour))
    : table(map.layers.find((layer) => layer.name === shown.layer)!.ramp);
  const nothing = document.createElement("canvas");
  nothing.width = nothing.height = SIDE;
  const source = new ImageTile({
    projection,
    tileGrid: tileGrid(map),
    wrapX: false,
    transition: 0,
    interpolate: false,
    loader: async (z, x, y, { signal }) => {
      try {
        const blob = await data.tile(map, shown, map.levels - z, -y - 1, x, signal);
        return blob ? await paint(blob, colours) : nothing;
      } catch (error) {
        if (!(error instanceof DOMException)) announce((error as Error).message, "error");
        throw error;
      }
    },
  });
  // Cells are drawn as large as they are stored, or larger: none is left out between two pixels.
  source.zDirection = 1;
  return source;
}

// Maps inside the page itself: a page to send.

import type { About, FeatureTable, Frames, MapAbout, Scale, Shown, Source, Track } from "./data";
import { greyAt } from "./ramp";

const SIDE = 256;

interface Embedded {
  about: About;
  maps: {
    tiles: Record<string, string>;
    scale: Scale;
    tracks: Record<string, Track>;
    frames: Frames;
    features: FeatureTable[];
  }[];
}

/** The source that is in the page, if it is such a page. */
export function embedded(): Source | null {
  const element = document.getElementById("fieldgrid-data");
  return element && new EmbeddedMaps(JSON.parse(element.textContent!) as Embedded);
}

class EmbeddedMaps implements Source {
  readonly cell = null;
  readonly image = null;
  readonly changes = null;
  readonly actions = null;

  constructor(private readonly data: Embedded) {}

  async about(): Promise<About> {
    return this.data.about;
  }

  async tile(map: MapAbout, _: Shown, level: number, ty: number, tx: number): Promise<Blob | null> {
    const text = this.data.maps[map.number].tiles[`${level}/${ty}/${tx}`];
    if (!text) return null;
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Blob([bytes], { type: "image/png" });
  }

  async scale(map: MapAbout): Promise<Scale> {
    return this.data.maps[map.number].scale;
  }

  async track(map: MapAbout, session: number): Promise<Track> {
    return this.data.maps[map.number].tracks[session];
  }

  async frames(map: MapAbout): Promise<Frames> {
    return this.data.maps[map.number].frames;
  }

  async features(map: MapAbout): Promise<FeatureTable[]> {
    return this.data.maps[map.number].features;
  }

  value = async (map: MapAbout, east: number, north: number): Promise<number | null> => {
    const [i, j] = [Math.floor(east / map.cell_m), Math.floor(north / map.cell_m)];
    const [tx, ty] = [Math.floor(i / SIDE), Math.floor(j / SIDE)];
    const blob = await this.tile(map, { layer: "density", sessions: null }, 0, ty, tx);
    return blob && greyAt(blob, i - tx * SIDE, SIDE - 1 - (j - ty * SIDE));
  };
}

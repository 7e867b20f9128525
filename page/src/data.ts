// What the page is told of maps, and where it comes from: a server, or the page itself.

export type Stop = [share: number, colour: string];
export type Bounds = [west: number, south: number, east: number, north: number];

export interface Layer {
  name: string;
  subject: string;
  title: string;
  says: string;
  unit: string;
  ramp: Stop[];
  obstacle_above: number | null;
}

export interface Session {
  number: number;
  name: string;
  colour: string;
  active: boolean;
  created: string;
  removed: string | null;
  driven: string;
  source: string;
  heading_source: string;
  frames: number;
  accepted: number;
  first_ms: number | null;
  last_ms: number | null;
}

export type MarkKind = "keepout" | "free" | "obstacle" | "place";

/** What somebody said of a place: a point of one corner, or a polygon. */
export interface NewMark {
  kind: MarkKind;
  corners: [east: number, north: number][];
  name: string;
  note: string;
  author: string;
}

export interface Mark extends NewMark {
  id: number;
  created: string;
  removed: string | null;
  holes: [east: number, north: number][][];
}

/** A map of a farm; one with a problem cannot be read, and has no bounds. */
export interface Block {
  name: string;
  bounds: Bounds | null;
  area_m2: number;
  sessions: number[];
  problem: string;
  datum_away_m: number;
}

export interface MapAbout {
  number: number;
  name: string;
  version: string;
  datum: { lat_deg: number; lon_deg: number; height_m: number };
  cell_m: number;
  levels: number;
  bounds: Bounds | null;
  layers: Layer[];
  changes: { name: string; says: string; colour: string }[];
  colours: { unseen: string; gears: Record<string, string>; rejected: string; marks: Record<MarkKind, string>; found: Record<string, string>; route: string };
  marks: Mark[];
  sessions: Session[];
  order: number[];
  /** The maps of a farm, which is shown like a map, and not changed; null for a map. */
  blocks: Block[] | null;
}

export interface Scale {
  low: number;
  high: number;
}

export interface Track {
  rows: number;
  of: number;
  heading_source: string;
  start_ms: number;
  time_ms: number[];
  east_m: (number | null)[];
  north_m: (number | null)[];
  up_m: (number | null)[];
  heading_deg: (number | null)[];
  heading_sigma_deg: (number | null)[];
  position_sigma_m: (number | null)[];
  speed_mps: (number | null)[];
  residual_m: (number | null)[];
  gear: number[];
  quality: number[];
  status: ("ok" | "held" | "rejected")[];
  reason: number[];
  reasons: string[];
}

export interface Frames {
  of: number;
  session: number[];
  frame_id: string[];
  reason: string[];
  accepted: boolean[];
  time_ms: number[];
  east_m: number[];
  north_m: number[];
  heading_deg: (number | null)[];
  width_m: number[];
  length_m: number[];
}

export interface SeenBy {
  session: number;
  frame_id: string;
  density: number;
  obstacle: boolean;
  cells: number;
  time_ms: number;
  east_m: number;
  north_m: number;
  heading_deg: number;
  heading_sigma_deg: number | null;
  position_sigma_m: number | null;
  quality: number | null;
  images: string[];
  places: (Bounds | null)[];
}

export interface Cell {
  east_m: number;
  north_m: number;
  bounds: Bounds;
  verdict: string;
  values: Record<string, number | null>;
  frames: SeenBy[];
}

export interface Feature {
  geometry: [kind: 1 | 2 | 3, rings: [number, number][][]][];
  attributes: Record<string, string | number>;
}

export interface FeatureTable {
  table: string;
  says: string;
  features: Feature[];
  cut: boolean;
}

/** An object that changed between two moments of a map. */
export interface ChangedObject {
  id: string;
  kind: "appeared" | "vanished" | "moved" | "grown" | "cut_back";
  geometry: Feature["geometry"];
  east_m: number;
  north_m: number;
  from: [number, number] | null;
  area_m2: number;
  length_m: number;
  width_m: number;
  confidence: number;
  stood: string[];
  freed: string[];
}

export interface About {
  maps: MapAbout[];
  writable: boolean;
  formats: { name: string; says: string }[];
}

/** What is to be exported: all of the map, or what lies within bounds. */
export interface ExportAsked {
  format: string;
  layer: string;
  bounds: Bounds | null;
  cell_m: number | null;
}

/** What may be done with a map besides looking at it. */
export interface Actions {
  changeSession(map: MapAbout, action: "remove" | "restore", session: string): Promise<void>;
  addMark(map: MapAbout, mark: NewMark): Promise<void>;
  changeMark(map: MapAbout, action: "remove" | "restore", mark: number): Promise<void>;
  export(map: MapAbout, asked: ExportAsked): Promise<{ blob: Blob; name: string }>;
}

export interface Picture {
  blob: Blob;
  width_px: number;
  height_px: number;
}

/** Which cells a tile shows: a layer over some sessions (null: all), or a change. */
export interface Shown {
  layer: string;
  sessions: number[] | null;
  between?: [from: number, to: number];
}

export interface Source {
  about(): Promise<About>;
  tile(map: MapAbout, shown: Shown, level: number, ty: number, tx: number, stop: AbortSignal): Promise<Blob | null>;
  scale(map: MapAbout, layer: string): Promise<Scale>;
  track(map: MapAbout, session: number): Promise<Track>;
  frames(map: MapAbout, bounds: Bounds, sessions: number[] | null): Promise<Frames>;
  features(map: MapAbout): Promise<FeatureTable[]>;
  /** The objects that changed between two sessions, in a part or all of the map. */
  changes: ((map: MapAbout, from: number, to: number, bounds: Bounds | null) => Promise<ChangedObject[]>) | null;
  /** Why a cell has its value; null where the source does not have the evidence. */
  cell: ((map: MapAbout, east: number, north: number, sessions: number[] | null) => Promise<Cell>) | null;
  image: ((map: MapAbout, frame: SeenBy, image: number) => Promise<Picture>) | null;
  actions: Actions | null;
  /** What is drawn of a cell, where nothing else is known of it. */
  value: ((map: MapAbout, east: number, north: number) => Promise<number | null>) | null;
}

/** The server that the page came from. */
export class Server implements Source {
  readonly value = null;

  constructor(private readonly token: string) {}

  about(): Promise<About> {
    return this.json("api/maps");
  }

  async tile(map: MapAbout, shown: Shown, level: number, ty: number, tx: number, stop: AbortSignal): Promise<Blob | null> {
    const query = new URLSearchParams({ v: map.version });
    if (shown.between) {
      query.set("from", String(shown.between[0]));
      query.set("to", String(shown.between[1]));
    } else if (shown.sessions) {
      query.set("sessions", shown.sessions.join("."));
    }
    const layer = shown.between ? "change" : shown.layer;
    const path = `api/maps/${map.number}/tiles/${layer}/${level}/${ty}/${tx}?${query}`;
    const answer = await this.ask(path, { signal: stop });
    return answer.status === 204 ? null : answer.blob();
  }

  scale(map: MapAbout, layer: string): Promise<Scale> {
    return this.json(`api/maps/${map.number}/scales/${layer}`);
  }

  track(map: MapAbout, session: number): Promise<Track> {
    return this.json(`api/maps/${map.number}/tracks/${session}`);
  }

  frames(map: MapAbout, bounds: Bounds, sessions: number[] | null): Promise<Frames> {
    const query = new URLSearchParams({ bounds: bounds.map((v) => v.toFixed(2)).join(",") });
    if (sessions) query.set("sessions", sessions.join("."));
    return this.json(`api/maps/${map.number}/frames?${query}`);
  }

  async features(map: MapAbout): Promise<FeatureTable[]> {
    const found = await this.json<{ tables: FeatureTable[] }>(`api/maps/${map.number}/features`);
    return found.tables;
  }

  changes = async (map: MapAbout, from: number, to: number, bounds: Bounds | null): Promise<ChangedObject[]> => {
    const query = new URLSearchParams({ from: String(from), to: String(to) });
    if (bounds) query.set("bounds", bounds.map((v) => v.toFixed(1)).join(","));
    return (await this.json<{ objects: ChangedObject[] }>(`api/maps/${map.number}/changes?${query}`)).objects;
  };

  cell = (map: MapAbout, east: number, north: number, sessions: number[] | null): Promise<Cell> => {
    const query = new URLSearchParams({ east: east.toFixed(4), north: north.toFixed(4) });
    if (sessions) query.set("sessions", sessions.join("."));
    return this.json(`api/maps/${map.number}/cell?${query}`);
  };

  image = async (map: MapAbout, frame: SeenBy, image: number): Promise<Picture> => {
    const query = new URLSearchParams({
      session: String(frame.session),
      frame: frame.frame_id,
      image: String(image),
    });
    const answer = await this.ask(`api/maps/${map.number}/image?${query}`);
    const size = (answer.headers.get("X-Image-Size") ?? "0 0").split(" ").map(Number);
    return { blob: await answer.blob(), width_px: size[0], height_px: size[1] };
  };

  readonly actions: Actions = {
    changeSession: async (map, action, session) => {
      await this.post(`api/maps/${map.number}/sessions`, { version: map.version, action, session });
    },
    addMark: async (map, mark) => {
      await this.post(`api/maps/${map.number}/marks`, { version: map.version, ...mark });
    },
    changeMark: async (map, action, mark) => {
      await this.post(`api/maps/${map.number}/marks/change`, { version: map.version, action, mark });
    },
    export: async (map, asked) => {
      const answer = await this.post(`api/maps/${map.number}/export`, asked);
      const name = answer.headers.get("Content-Disposition")?.match(/filename="([^"]+)"/)?.[1];
      return { blob: await answer.blob(), name: name ?? map.name };
    },
  };

  private post(path: string, value: unknown): Promise<Response> {
    const headers = { "Content-Type": "application/json" };
    return this.ask(path, { method: "POST", headers, body: JSON.stringify(value) });
  }

  private async json<T>(path: string): Promise<T> {
    return (await this.ask(path)).json() as Promise<T>;
  }

  private async ask(path: string, options: RequestInit = {}): Promise<Response> {
    let answer: Response;
    try {
      answer = await fetch(path, { ...options, headers: { "X-Fieldgrid-Token": this.token, ...options.headers } });
    } catch (error) {
      if (error instanceof DOMException) throw error; // aborted
      throw new Error("fieldgrid view does not answer; start it again and load this page anew.");
    }
    if (!answer.ok) {
      const said = await answer.json().catch(() => ({}));
      throw new Error(said.error ?? `The server answered ${answer.status}.`);
    }
    return answer;
  }
}

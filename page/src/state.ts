// What is shown, in one place; whoever draws something listens to it.

import type { ChangedObject, MapAbout, Source } from "./data";

export type Comparing = "off" | "swipe" | "fade" | "change";

export interface State {
  map: MapAbout;
  layer: string;
  /** Sessions that are switched off, by number. */
  hidden: Set<number>;
  comparing: Comparing;
  /** The two moments that are compared: the map as of these sessions. */
  before: number;
  after: number;
  /** What changed between them, as far as it was looked for. */
  changed: ChangedObject[];
  /** Where the swipe is, or how far the fade has come, 0..1. */
  share: number;
  colourBy: "gear" | "session";
  visible: Record<Overlay, boolean>;
}

export type Overlay = "tracks" | "headings" | "frames" | "footprints" | "features" | "marks" | "blocks";

export type Topic = "map" | "layer" | "sessions" | "compare" | "changed" | "share" | "overlays";

export class Store {
  private readonly listeners = new Map<Topic, (() => void)[]>();

  constructor(readonly source: Source, public state: State) {}

  on(topics: Topic[], listener: () => void): void {
    for (const topic of topics) {
      this.listeners.set(topic, [...(this.listeners.get(topic) ?? []), listener]);
    }
  }

  change(topic: Topic, change: Partial<State>): void {
    Object.assign(this.state, change);
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  /** The sessions of the map that are in it and switched on; null for all that are in it. */
  shownSessions(): number[] | null {
    const { map, hidden } = this.state;
    const active = map.sessions.filter((session) => session.active);
    const shown = active.filter((session) => !hidden.has(session.number));
    return shown.length === active.length ? null : shown.map((session) => session.number);
  }

  /** The sessions of the map as of one of them that are switched on. */
  sessionsAsOf(session: number): number[] | null {
    const { map, hidden } = this.state;
    const until = map.order.slice(0, map.order.indexOf(session) + 1);
    const shown = until.filter((number) => !hidden.has(number));
    return shown.length === map.order.length ? null : shown;
  }
}

/** How a map is shown at first. */
export function initial(map: MapAbout): State {
  return {
    map,
    layer: "density",
    hidden: new Set(),
    comparing: "off",
    before: map.order[0] ?? 0,
    after: map.order[map.order.length - 1] ?? 0,
    changed: [],
    share: 0.5,
    colourBy: map.order.length > 1 ? "session" : "gear",
    visible: { tracks: true, headings: false, frames: false, footprints: false, features: true, marks: true, blocks: true },
  };
}

// The drives that are loaded, and the pose nearest to a place or a moment.

import type { MapAbout, Source, Track } from "./data";

/** A row of a drive's track. */
export interface Row {
  session: number;
  row: number;
}

export class Tracks {
  private readonly loaded = new Map<number, Promise<Track>>();
  readonly ready = new Map<number, Track>();

  constructor(private readonly source: Source, private readonly map: MapAbout) {}

  /** A drive's track, asked for once. */
  load(session: number): Promise<Track> {
    let found = this.loaded.get(session);
    if (!found) {
      found = this.source.track(this.map, session).then((track) => {
        this.ready.set(session, track);
        return track;
      });
      found.catch(() => this.loaded.delete(session));
      this.loaded.set(session, found);
    }
    return found;
  }

  /** The pose nearest to a place, of some sessions, within a distance. */
  nearest(east: number, north: number, within: number, sessions: Iterable<number>): Row | null {
    let best = within * within;
    let found: Row | null = null;
    for (const session of sessions) {
      const track = this.ready.get(session);
      if (!track?.rows) continue;
      for (let row = 0; row < track.rows; row++) {
        const e = track.east_m[row];
        const n = track.north_m[row];
        if (e === null || n === null) continue;
        const apart = (e - east) ** 2 + (n - north) ** 2;
        if (apart <= best) {
          best = apart;
          found = { session, row };
        }
      }
    }
    return found;
  }
}

export const GEARS: Record<string, string> = { "1": "forward", "-1": "reverse", "0": "at rest" };

/** GGA's codes of fix quality in words. */
export const QUALITIES = [
  "no fix", "GPS", "differential", "PPS", "RTK fixed", "RTK float", "estimated", "manual", "simulated", "SBAS",
];

/** Rows that belong together in time: no hole longer than three usual steps, and 1.5 s at least. */
export function isHole(track: Track, row: number, usualMs: number): boolean {
  return row > 0 && track.time_ms[row] - track.time_ms[row - 1] > Math.max(1500, 3 * usualMs);
}

/** The usual step of a track, milliseconds. */
export function usualStep(track: Track): number {
  const steps = track.time_ms.slice(1).map((t, k) => t - track.time_ms[k]);
  steps.sort((a, b) => a - b);
  return steps[steps.length >> 1] ?? 0;
}

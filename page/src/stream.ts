// What a live session tells, as it comes: a stream that is opened again when it ends.

export interface Pose {
  east_m: number | null;
  north_m: number | null;
  heading_deg: number | null;
  position_sigma_m: number | null;
  heading_sigma_deg: number | null;
  speed_mps: number | null;
  gear: number;
  is_good: boolean;
}

export type Fix = [east: number, north: number, quality: number, used: boolean];
export type Step = [east: number, north: number, gear: number, good: boolean];

export interface LiveWindow {
  time_ns: number;
  trusted: boolean;
  doubt: string;
  frames: number;
  bounds_m: [west: number, south: number, east: number, north: number];
  oldest_s: number | null;
  worst_sigma_m: number | null;
  latency_ms: number | null;
  datum: { lat_deg: number; lon_deg: number; height_m: number };
  cell_m: number;
  pose: Pose | null;
  fixes: Fix[];
  /** A picture, base64: cost in red, age in green, how far off in blue. */
  cells: string;
}

export interface Told {
  session: string;
  path: Step[];
  events: [what: string, text: string][];
  window: LiveWindow | null;
}

export interface Listener {
  /** What is new; of the first of a stream that is all there is. */
  told(told: Told, isFirst: boolean): void;
  /** The connection is gone, or the session has ended; it is tried again. */
  lost(why: string): void;
}

export const ENDED = "The session has ended";

/** The server sends something every two seconds at least. */
const SILENT_MS = 7_000;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5_000;

/** Listens for ever. */
export async function listen(token: string, listener: Listener): Promise<void> {
  for (let wait = FIRST_WAIT_MS; ; wait = Math.min(2 * wait, LONGEST_WAIT_MS)) {
    let why = "The session cannot be reached";
    try {
      let isFirst = true;
      why = await once(token, (told) => {
        wait = FIRST_WAIT_MS;
        listener.told(told, isFirst);
        isFirst = false;
      });
    } catch (error) {
      if (error instanceof Refused) why = error.message;
    }
    listener.lost(why);
    await new Promise((done) => setTimeout(done, wait));
  }
}

class Refused extends Error {}

/** Reads one stream to its end, and returns why it ended. */
async function once(token: string, take: (told: Told) => void): Promise<string> {
  const stop = new AbortController();
  let alarm = setTimeout(() => stop.abort(), SILENT_MS);
  try {
    const answer = await fetch("api/live", { headers: { "X-Fieldgrid-Token": token }, cache: "no-store", signal: stop.signal });
    if (!answer.ok) throw new Refused(((await answer.json()) as { error: string }).error);
    const reader = answer.body!.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return "The session cannot be reached";
      clearTimeout(alarm);
      alarm = setTimeout(() => stop.abort(), SILENT_MS);
      text += value;
      const parts = text.split("\n\n");
      text = parts.pop()!;
      for (const part of parts) {
        if (part.startsWith("event: end")) return ENDED;
        if (part.startsWith("data: ")) take(JSON.parse(part.slice(6)) as Told);
      }
    }
  } finally {
    clearTimeout(alarm);
    stop.abort();
  }
}

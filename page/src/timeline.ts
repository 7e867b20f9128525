// Time lines of a drive: heading with sigma, speed, gear, quality of fixes, residuals; linked with the map.

import uPlot from "uplot";

import type { Track } from "./data";
import { el, moment, number, plural } from "./dom";
import type { Store } from "./state";
import { GEARS, QUALITIES, type Row, type Tracks, isHole, usualStep } from "./tracks";

interface Chart {
  name: string;
  height: number;
  columns(track: Track): (number | null)[][];
  series: uPlot.Series[];
  bands?: uPlot.Band[];
  range: (track: Track) => [number, number];
  /** Where the axis has marks, and what they say; by default as uPlot likes. */
  splits?: (low: number, high: number) => number[];
  values?: (split: number) => string;
}

const FONT = "11px system-ui, sans-serif";
const LINE = { width: 1.5, points: { show: false } };

function charts(ink: string, soft: string): Chart[] {
  const edge = { stroke: "#0000", width: 1, points: { show: false } };
  const steps = { ...LINE, stroke: ink, paths: uPlot.paths.stepped!({ align: 1 }) };
  return [
    {
      name: "heading °",
      height: 92,
      columns: (t) => {
        const heading = unwrapped(t.heading_deg);
        return [
          heading,
          heading.map((h, k) => plus(h, t.heading_sigma_deg[k], 1)),
          heading.map((h, k) => plus(h, t.heading_sigma_deg[k], -1)),
        ];
      },
      series: [{ ...LINE, stroke: ink }, edge, edge],
      bands: [{ series: [2, 3], fill: soft }],
      range: (t) => around(unwrapped(t.heading_deg)),
      // A full turn goes on upwards or downwards, so that no line crosses the chart.
      splits: (low, high) => multiples(high - low > 400 ? 180 : 90, low, high),
      values: (split) => String(((((split + 180) % 360) + 360) % 360) - 180),
    },
    {
      name: "speed m/s",
      height: 66,
      columns: (t) => [t.speed_mps],
      series: [{ ...LINE, stroke: ink }],
      range: (t) => around(t.speed_mps),
      splits: (low, high) => multiples(high - low > 5 ? 5 : 1, low, high),
    },
    {
      name: "gear",
      height: 58,
      columns: (t) => [t.gear],
      series: [steps],
      range: () => [-1.4, 1.4],
      splits: () => [-1, 0, 1],
      values: (split) => GEARS[String(split)],
    },
    {
      name: "fix",
      height: 58,
      columns: (t) => [t.quality],
      series: [steps],
      range: () => [-0.5, 9.5],
      splits: () => [1, 4],
      values: (split) => QUALITIES[split],
    },
    {
      name: "residual m",
      height: 66,
      columns: (t) => [t.residual_m],
      // A fix each: between two of them nothing is known.
      series: [{ stroke: ink, paths: () => null, points: { show: true, size: 3, width: 1, fill: ink } }],
      range: (t) => around([0, ...t.residual_m]),
    },
  ];
}

export class Timeline {
  readonly element: HTMLElement;
  /** Called with the pose that the pointer is at, or null. */
  onHover: (row: Row | null) => void = () => {};
  private readonly choice = el("select", { id: "timeline-session", change: () => void this.show() });
  private readonly slider = el("input", { type: "range", min: 0, max: 0, value: 0, id: "timeline-row", input: () => this.slide() });
  private readonly text = el("output", { for: "timeline-row", id: "timeline-text" });
  private readonly place = el("div", { class: "charts" });
  private plots: uPlot[] = [];
  private track: Track | null = null;
  private session = 0;
  /** The row of the track at each place of the charts' arrays. */
  private rows: number[] = [];
  private quiet = false;

  constructor(private readonly store: Store, private readonly tracks: () => Tracks) {
    this.element = el(
      "section",
      { id: "timeline", class: "panel", "aria-label": "Time lines", hidden: true },
      el("div", { class: "row" }, el("label", { for: "timeline-session" }, "Drive"), this.choice, el("label", { for: "timeline-row" }, "Moment"), this.slider),
      this.text,
      this.place,
    );
    store.on(["map"], () => this.begin());
    new ResizeObserver(() => this.resize()).observe(this.place);
    this.begin();
  }

  get shown(): boolean {
    return !this.element.hidden;
  }

  toggle(shown: boolean): void {
    this.element.hidden = !shown;
    if (shown && !this.track) void this.show();
    if (!shown) this.onHover(null);
  }

  private begin(): void {
    const active = this.store.state.map.sessions.filter((session) => session.active);
    this.choice.replaceChildren(...active.map((s) => el("option", { value: s.number }, `${s.name} (${s.driven})`)));
    this.track = null;
    if (this.shown) void this.show();
  }

  private async show(): Promise<void> {
    this.session = Number(this.choice.value);
    const track = await this.tracks().load(this.session);
    if (this.session !== Number(this.choice.value)) return;
    this.track = track;
    this.draw();
  }

  /** Draws the charts anew: for another drive, or other colours. */
  draw(): void {
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    this.place.replaceChildren();
    const track = this.track;
    if (!track) return;
    this.slider.max = String(Math.max(track.rows - 1, 0));
    if (!track.rows) {
      this.place.append(el("p", {}, "This session has no trajectory."));
      return;
    }
    const style = getComputedStyle(this.element);
    const [ink, soft, text] = ["--ink", "--soft", "--text"].map((name) => style.getPropertyValue(name).trim());
    const breaks = this.breaks(track);
    const time = this.rows.map((row) => (track.start_ms + track.time_ms[row]) / 1000);
    // A break takes a moment of its own, just before the row that follows it.
    breaks.forEach((broken, k) => broken && (time[k] -= 1e-4));
    const sync = uPlot.sync("fieldgrid");
    const all = charts(ink, soft);
    all.forEach((chart, index) => {
      const columns = chart.columns(track).map((column) => this.rows.map((row, k) => (breaks[k] ? null : column[row])));
      const last = index === all.length - 1;
      const figure = el("figure", { role: "img", "aria-label": `${chart.name} against time` });
      this.place.append(figure);
      const axis = { stroke: text, grid: { stroke: soft, width: 1 }, ticks: { stroke: soft, width: 1 } };
      const plot = new uPlot(
        {
          width: Math.max(this.place.clientWidth, 200),
          height: chart.height + (last ? 28 : 0),
          legend: { show: false },
          padding: [5, 24, last ? 0 : 5, 0],
          tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC"),
          cursor: { sync: { key: sync.key }, y: false, drag: { x: true, y: false }, points: { show: false } },
          scales: { x: { time: true }, y: { range: chart.range(track) } },
          axes: [
            { ...axis, show: last, size: 28, font: FONT },
            {
              ...axis,
              label: chart.name,
              labelSize: 16,
              labelGap: 0,
              size: 66,
              labelFont: FONT,
              font: FONT,
              splits: chart.splits ? (u) => chart.splits!(u.scales.y.min!, u.scales.y.max!) : undefined,
              values: chart.values ? (_, splits) => splits.map(chart.values!) : undefined,
            },
          ],
          series: [{}, ...chart.series],
          bands: chart.bands,
          hooks: { setCursor: [(u) => index === 0 && this.pointed(u)] },
        },
        [time, ...columns] as uPlot.AlignedData,
        figure,
      );
      sync.sub(plot);
      this.plots.push(plot);
    });
  }

  /** Where lines break: at holes in time. */
  private breaks(track: Track): boolean[] {
    const usual = usualStep(track);
    const breaks: boolean[] = [];
    this.rows = [];
    for (let row = 0; row < track.rows; row++) {
      for (const broken of isHole(track, row, usual) ? [true, false] : [false]) {
        this.rows.push(row);
        breaks.push(broken);
      }
    }
    return breaks;
  }

  private pointed(plot: uPlot): void {
    const index = plot.cursor.idx;
    if (this.quiet) return;
    if (index === null || index === undefined || (plot.cursor.left ?? -1) < 0) {
      this.onHover(null);
      return;
    }
    this.tell(this.rows[index]);
    this.onHover({ session: this.session, row: this.rows[index] });
  }

  private slide(): void {
    const row = Number(this.slider.value);
    this.point({ session: this.session, row });
    this.onHover({ session: this.session, row });
  }

  /** Points at a pose, as the map does. */
  point(row: Row | null): void {
    if (!this.shown || !this.track || !this.plots.length) return;
    if (row && row.session !== this.session) return;
    this.quiet = true; // the map knows already
    const index = row ? this.rows.indexOf(row.row) : -1;
    for (const plot of this.plots) {
      plot.setCursor(index < 0 ? { left: -10, top: -10 } : { left: plot.valToPos(plot.data[0][index], "x"), top: 0 }, false);
    }
    this.quiet = false;
    if (row) this.tell(row.row);
  }

  private tell(row: number): void {
    this.slider.value = String(row);
    this.text.textContent = this.track ? poseInWords(this.track, row) : "";
  }

  private resize(): void {
    const width = this.place.clientWidth;
    if (width) for (const plot of this.plots) plot.setSize({ width, height: plot.height });
  }
}

/** What is known of a pose, in one sentence. */
export function poseInWords(track: Track, row: number): string {
  const parts = [
    moment(track.start_ms + track.time_ms[row]),
    `heading ${number(track.heading_deg[row], 1, "°")} ± ${number(track.heading_sigma_deg[row], 2, "°")}`,
    `position ± ${number(track.position_sigma_m[row], 3, "m")}`,
    `${number(track.speed_mps[row], 2, "m/s")} ${GEARS[String(track.gear[row])] ?? ""}`,
    QUALITIES[track.quality[row]] ?? `quality ${track.quality[row]}`,
  ];
  if (track.residual_m[row] !== null) parts.push(`fix ${number(track.residual_m[row], 3, "m")} off the pose`);
  parts.push(verdict(track, row));
  return parts.join(" · ");
}

/** The verdict on a pose, and why. */
export function verdict(track: Track, row: number): string {
  const why = track.reason[row] >= 0 ? `: ${track.reasons[track.reason[row]]}` : "";
  const words = { ok: "used", held: "at rest, heading held", rejected: "rejected" };
  return words[track.status[row]] + why;
}

export function summary(track: Track): string {
  if (!track.rows) return "no trajectory";
  const refused = track.status.filter((status) => status === "rejected").length;
  return `${plural(track.of, "pose")}${track.rows < track.of ? `, ${track.rows.toLocaleString("en")} of them drawn` : ""}, ${refused} rejected`;
}

/** Headings that go on beyond 180° where they would jump. */
function unwrapped(headings: (number | null)[]): (number | null)[] {
  let turns = 0;
  let last: number | null = null;
  return headings.map((heading) => {
    if (heading === null) return null;
    if (last !== null) turns += Math.round((last - heading) / 360);
    last = heading;
    return heading + 360 * turns;
  });
}

function multiples(step: number, low: number, high: number): number[] {
  const found: number[] = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) found.push(value);
  return found;
}

function plus(a: number | null, b: number | null, sign: number): number | null {
  return a === null || b === null ? null : a + sign * b;
}

function around(values: (number | null)[]): [number, number] {
  const known = values.filter((v): v is number => v !== null);
  const low = known.reduce((a, b) => Math.min(a, b), Number.POSITIVE_INFINITY);
  const high = known.reduce((a, b) => Math.max(a, b), Number.NEGATIVE_INFINITY);
  if (!(high >= low)) return [0, 1];
  const margin = Math.max(0.05 * (high - low), 0.01);
  return [low - margin, high + margin];
}

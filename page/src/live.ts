// The page that follows the vehicle: the window around it, its pose, its path, and what is doubtful.

import Feature from "ol/Feature";
import OlMap from "ol/Map";
import View from "ol/View";
import Zoom from "ol/control/Zoom";
import CircleGeometry from "ol/geom/Circle";
import MultiLineString from "ol/geom/MultiLineString";
import MultiPoint from "ol/geom/MultiPoint";
import Point from "ol/geom/Point";
import { defaults as interactions } from "ol/interaction/defaults";
import ImageLayer from "ol/layer/Image";
import VectorLayer from "ol/layer/Vector";
import ImageCanvas from "ol/source/ImageCanvas";
import VectorSource from "ol/source/Vector";
import { Circle, Fill, RegularShape, Stroke, Style } from "ol/style";

import type { Stop } from "./data";
import { announce, el, number, swatch } from "./dom";
import { ScaleBar, plane } from "./mapview";
import { toGeodetic } from "./plane";
import { decode, gradient, table } from "./ramp";
import { ENDED, type LiveWindow, type Pose, type Step, type Told, listen } from "./stream";
import { GEARS, QUALITIES } from "./tracks";

interface Colours {
  cost: Stop[];
  values: Stop[];
  unsure: Stop[];
  gears: Record<string, string>;
  rejected: string;
  measured: string;
  age_unit_s: number;
  sigma_unit_m: number;
}

const RTK_FIXED = 4;
const UNKNOWN = 255;
const MOST_PATH = 20_000;
const MOST_EVENTS = 30;
const FIRST_WIDTH_M = 30;
/** Older than this a window is not what is around the vehicle now. */
const OLD_MS = 3_000;

type Shown = "cost" | "age" | "sigma";

export async function follow(token: string): Promise<void> {
  const answer = await fetch("api/colours", { headers: { "X-Fieldgrid-Token": token } });
  if (!answer.ok) {
    announce(((await answer.json()) as { error: string }).error, "error");
    return;
  }
  const page = new LivePage((await answer.json()) as Colours);
  await listen(token, page);
}

class LivePage {
  private readonly map: OlMap;
  private readonly target = el("div", { id: "map", tabindex: 0, role: "application", "aria-label": "Map around the vehicle. Arrow keys move it, plus and minus zoom, F follows the vehicle." });
  private readonly verdict = el("p", { id: "doubt", role: "status", "aria-live": "assertive" }, "Waiting for the session.");
  private readonly facts = el("tbody", { id: "pose" });
  private readonly events = el("ol", { id: "events" });
  private readonly readout = el("output", { id: "readout", "aria-label": "Position" });
  private readonly legend = el("div", { id: "legend" });
  private readonly session = el("span", { class: "name" });
  private readonly following: HTMLButtonElement;
  private readonly cells = new ImageLayer<ImageCanvas>({ zIndex: 0 });
  private readonly paths = new Map(["1", "-1", "0"].map((gear) => [gear, new Feature(new MultiLineString([]))]));
  private readonly rejected = new Feature(new MultiPoint([]));
  private readonly used = new Feature(new MultiPoint([]));
  private readonly unused = new Feature(new MultiPoint([]));
  private readonly vehicle = new Feature(new Point([0, 0]));
  private readonly sure = new Feature(new CircleGeometry([0, 0], 0));
  private readonly tables: Record<Shown, Uint32Array>;
  private steps: Step[] = [];
  private window: LiveWindow | null = null;
  private pixels: ImageData | null = null;
  private shown: Shown = "cost";
  private isFollowing = true;
  private hasView = false;
  private why = "";
  private heardMs = -Infinity;
  private drawn = 0;

  constructor(private readonly colours: Colours) {
    this.tables = { cost: table(colours.cost), age: table(colours.values), sigma: table(colours.unsure) };
    this.following = el("button", { id: "follow", type: "button", "aria-pressed": "true", "aria-keyshortcuts": "f", click: () => this.setFollowing(!this.isFollowing) }, "Follow (F)");
    const choice = el(
      "select",
      { id: "layer", change: () => this.show(choice.value as Shown) },
      el("option", { value: "cost" }, "Cost"),
      el("option", { value: "age" }, "Age: how long ago it was seen"),
      el("option", { value: "sigma" }, "Error: how far off it may be"),
    );
    const theme = el("button", { id: "theme", type: "button", "aria-label": "Light or dark", click: () => {
      const dark = getComputedStyle(document.documentElement).colorScheme.trim() === "dark";
      document.documentElement.dataset.theme = dark ? "light" : "dark";
    } }, "◐");
    document.body.append(
      el("header", {}, el("h1", {}, "fieldgrid live"), this.session, el("div", { class: "buttons" }, this.following, theme)),
      this.verdict,
      el("main", {},
        el("nav", { id: "panels", class: "panel", "aria-label": "What is known" },
          el("label", { class: "row" }, "Cells", choice), this.legend,
          el("h2", {}, "Vehicle"), el("table", {}, this.facts),
          el("h2", {}, "Told"), this.events),
        el("div", { id: "stage" }, this.target, this.readout)),
    );
    const vectors = new VectorLayer({ zIndex: 1, source: new VectorSource({ wrapX: false, features: [...this.paths.values(), this.rejected, this.unused, this.used, this.sure, this.vehicle] }) });
    this.map = new OlMap({
      target: this.target,
      layers: [this.cells, vectors],
      controls: [new Zoom({ zoomInTipLabel: "Zoom in", zoomOutTipLabel: "Zoom out" }), new ScaleBar({ minWidth: 80 })],
      interactions: interactions({ altShiftDragRotate: false, pinchRotate: false }),
      keyboardEventTarget: this.target,
      view: new View({ projection: plane, center: [0, 0], resolution: 0.05, minResolution: 0.002, maxResolution: 5, enableRotation: false, constrainResolution: false }),
    });
    this.styles();
    this.drawLegend();
    this.map.on("pointerdrag", () => this.setFollowing(false));
    this.map.on("pointermove", (event) => this.read(event.coordinate));
    this.map.on("moveend", () => {
      this.target.dataset.extent = this.map.getView().calculateExtent(this.map.getSize()).join(" ");
    });
    this.map.on("rendercomplete", () => this.target.setAttribute("aria-busy", "false"));
    this.target.addEventListener("keydown", (event) => {
      if (event.key.startsWith("Arrow")) this.setFollowing(false);
    });
    document.addEventListener("keydown", (event) => {
      const typing = event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey;
      if (event.key.toLowerCase() === "f" && !typing) this.setFollowing(!this.isFollowing);
    });
    setInterval(() => this.judge(), 500);
  }

  told(told: Told, isFirst: boolean): void {
    this.heardMs = performance.now();
    this.why = "";
    this.session.textContent = told.session;
    document.title = `${told.session} · fieldgrid live`;
    if (isFirst) {
      this.steps = [];
      this.events.replaceChildren();
    }
    this.steps = [...this.steps, ...told.path].slice(-MOST_PATH);
    for (const [, text] of told.events) this.events.prepend(el("li", {}, text));
    while (this.events.children.length > MOST_EVENTS) this.events.lastElementChild!.remove();
    this.window = told.window;
    if (told.window) void this.draw(told.window);
    this.drawPath();
    this.judge();
  }

  lost(why: string): void {
    if (this.why !== ENDED) this.why = why;
    this.judge();
  }

  /** Says whether the window is to be trusted now, and why not. */
  private judge(): void {
    if (this.heardMs === -Infinity && !this.why) return; // it still waits
    const silentMs = performance.now() - this.heardMs;
    let doubt = this.window ? this.window.doubt : "there is no pose yet";
    if (this.why) doubt = `${this.why}; it is tried again`;
    else if (silentMs > OLD_MS) doubt = `nothing new for ${(silentMs / 1000).toFixed(0)} s`;
    const text = doubt ? `Not to be trusted: ${doubt.replace(/\.$/, "")}.` : "Can be trusted.";
    if (this.verdict.textContent !== text) this.verdict.textContent = text;
    this.verdict.classList.toggle("bad", doubt !== "");
    this.target.classList.toggle("stale", this.why !== "" || silentMs > OLD_MS);
  }

  private async draw(window: LiveWindow): Promise<void> {
    const turn = ++this.drawn;
    const bytes = Uint8Array.from(atob(window.cells), (char) => char.charCodeAt(0));
    const { pixels } = await decode(new Blob([bytes], { type: "image/png" }));
    if (turn !== this.drawn) return; // a newer one has come meanwhile
    this.pixels = pixels;
    this.paint(window);
    this.drawVehicle(window);
    this.drawFixes(window);
    this.tell(window);
  }

  /** The cells in the colours of what is shown of them. */
  private paint(window: LiveWindow): void {
    const { pixels } = this;
    if (!pixels) return;
    const channel = { cost: 0, age: 1, sigma: 2 }[this.shown];
    const made = new ImageData(pixels.width, pixels.height);
    const [words, colours] = [new Uint32Array(made.data.buffer), this.tables[this.shown]];
    for (let k = 0; k < words.length; k++) {
      const value = pixels.data[4 * k + channel];
      words[k] = value === UNKNOWN ? 0 : colours[value];
    }
    const canvas = el("canvas", { width: pixels.width, height: pixels.height });
    canvas.getContext("2d")!.putImageData(made, 0, 0);
    this.target.setAttribute("aria-busy", "true");
    const [west, , , north] = window.bounds_m;
    this.cells.setSource(new ImageCanvas({
      projection: plane,
      ratio: 1,
      interpolate: false,
      canvasFunction: (extent, resolution, ratio, size) => {
        const view = el("canvas", { width: Math.round(size[0]), height: Math.round(size[1]) });
        const context = view.getContext("2d")!;
        const scale = ratio / resolution;
        context.imageSmoothingEnabled = false;
        context.drawImage(canvas, (west - extent[0]) * scale, (extent[3] - north) * scale, canvas.width * window.cell_m * scale, canvas.height * window.cell_m * scale);
        return view;
      },
    }));
  }

  private drawVehicle({ pose }: LiveWindow): void {
    const place = at(pose);
    const none = pose === null || place === null;
    (this.vehicle.getGeometry() as Point).setCoordinates(none ? [] : place);
    (this.sure.getGeometry() as CircleGeometry).setCenterAndRadius(none ? [0, 0] : place, none ? 0 : (pose.position_sigma_m ?? 0));
    if (none) return;
    this.vehicle.setStyle(vehicle(pose, this.colours));
    if (!this.isFollowing) return;
    const view = this.map.getView();
    const width = this.map.getSize()?.[0];
    if (!this.hasView && width) {
      view.setResolution(FIRST_WIDTH_M / width);
      this.hasView = true;
    }
    view.setCenter(place);
  }

  private drawFixes({ fixes }: LiveWindow): void {
    for (const [feature, used] of [[this.used, true], [this.unused, false]] as const) {
      (feature.getGeometry() as MultiPoint).setCoordinates(fixes.filter((fix) => fix[3] === used).map(([e, n]) => [e, n]));
    }
  }

  private drawPath(): void {
    const lines = new Map<string, [number, number][][]>([...this.paths.keys()].map((gear) => [gear, []]));
    const bad: [number, number][] = [];
    let [before, last] = ["", null as [number, number] | null];
    for (const [east, north, gear, good] of this.steps) {
      if (!good) {
        bad.push([east, north]);
        continue;
      }
      const runs = lines.get(String(gear))!;
      // On from the last point of the gear before, so that the line is whole.
      if (String(gear) !== before) runs.push(last ? [last] : []);
      last = [east, north];
      runs[runs.length - 1].push(last);
      before = String(gear);
    }
    for (const [gear, feature] of this.paths) (feature.getGeometry() as MultiLineString).setCoordinates(lines.get(gear)!);
    (this.rejected.getGeometry() as MultiPoint).setCoordinates(bad);
  }

  private tell({ pose, ...window }: LiveWindow): void {
    const newest = window.fixes[window.fixes.length - 1];
    const fixed = window.fixes.filter((fix) => fix[2] === RTK_FIXED).length;
    const rows: [string, string][] = [
      ["east, north", pose ? `${number(pose.east_m, 2)}, ${number(pose.north_m, 2)} ± ${number(pose.position_sigma_m, 2, "m")}` : "–"],
      ["heading", pose ? `${number(pose.heading_deg, 1)}° ± ${number(pose.heading_sigma_deg, 1)}°` : "–"],
      ["speed", number(pose?.speed_mps, 2, "m/s")],
      ["gear", pose ? (pose.gear ? GEARS[pose.gear] : "at rest or not known") : "–"],
      ["receiver", newest ? (QUALITIES[newest[2]] ?? "not said") : "–"],
      ["fixes shown", `${window.fixes.length}, ${fixed} RTK fixed, ${window.fixes.filter((fix) => !fix[3]).length} not used`],
      ["frames in the window", String(window.frames)],
      ["oldest cell", number(window.oldest_s, 1, "s")],
      ["least sure cell", number(window.worst_sigma_m, 2, "m")],
      ["from the frame to here", number(window.latency_ms, 0, "ms")],
    ];
    this.facts.replaceChildren(...rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, value))));
  }

  private show(shown: Shown): void {
    this.shown = shown;
    this.drawLegend();
    if (this.window) this.paint(this.window);
  }

  private drawLegend(): void {
    const { cost, values, unsure, age_unit_s, sigma_unit_m, gears, rejected, measured } = this.colours;
    const [ramp, low, high] = {
      cost: [cost, "free", "obstacle"] as const,
      age: [values, "0 s", `${Math.round(254 * age_unit_s)} s or more`] as const,
      sigma: [unsure, "0 m", `${(254 * sigma_unit_m).toFixed(1)} m or more`] as const,
    }[this.shown];
    const bar = el("div", { class: "ramp" });
    bar.style.background = gradient([...ramp]);
    const swatches = el("div", { class: "swatches" },
      ...Object.entries(gears).map(([gear, colour]) => el("span", {}, swatch(colour, "line"), GEARS[gear])),
      el("span", {}, swatch(measured), "fix"), el("span", {}, swatch(rejected, "cross"), "not used"));
    this.legend.replaceChildren(bar, el("div", { class: "ends" }, el("span", {}, low), el("span", {}, high)), swatches);
  }

  private setFollowing(on: boolean): void {
    this.isFollowing = on;
    this.following.setAttribute("aria-pressed", String(on));
    const place = at(this.window?.pose ?? null);
    if (on && place) this.map.getView().setCenter(place);
  }

  private styles(): void {
    const { gears, measured, rejected } = this.colours;
    for (const [gear, feature] of this.paths) {
      feature.setStyle([
        new Style({ stroke: new Stroke({ color: "#ffffffcc", width: 5 }) }),
        new Style({ stroke: new Stroke({ color: gears[gear], width: 2.5 }) }),
      ]);
    }
    const cross = new Style({ image: new RegularShape({ points: 4, radius: 4, radius2: 0, angle: Math.PI / 4, stroke: new Stroke({ color: rejected, width: 1.5 }) }) });
    this.rejected.setStyle(cross);
    this.unused.setStyle(cross);
    this.used.setStyle(new Style({ image: new Circle({ radius: 3, fill: new Fill({ color: measured }), stroke: new Stroke({ color: "#ffffff", width: 1 }) }) }));
    this.sure.setStyle(new Style({ stroke: new Stroke({ color: measured, width: 1.5 }), fill: new Fill({ color: `${measured}22` }) }));
  }

  private read([east, north]: number[]): void {
    const { window, pixels } = this;
    if (!window) return;
    const [lat, lon] = toGeodetic(window.datum, east, north);
    const [west, , , top] = window.bounds_m;
    const [column, row] = [Math.floor((east - west) / window.cell_m), Math.floor((top - north) / window.cell_m)];
    let cell = "";
    if (pixels && column >= 0 && row >= 0 && column < pixels.width && row < pixels.height) {
      const [cost, age, sigma] = pixels.data.subarray(4 * (row * pixels.width + column));
      const { age_unit_s, sigma_unit_m } = this.colours;
      cell = cost === UNKNOWN ? "   never seen" : `   cost ${cost}, ${(age * age_unit_s).toFixed(1)} s ago, ± ${(sigma * sigma_unit_m).toFixed(2)} m`;
    }
    this.readout.textContent = `E ${east.toFixed(2)} m  N ${north.toFixed(2)} m   ${lat.toFixed(7)}°, ${lon.toFixed(7)}°${cell}`;
  }
}

function at(pose: Pose | null): [number, number] | null {
  return pose === null || pose.east_m === null || pose.north_m === null ? null : [pose.east_m, pose.north_m];
}

/** An arrow along the nose, in the colour of the gear; a ring where the heading is not known. */
function vehicle(pose: Pose, colours: Colours): Style {
  const colour = pose.is_good ? (colours.gears[pose.gear] ?? colours.rejected) : colours.rejected;
  const look = { fill: new Fill({ color: colour }), stroke: new Stroke({ color: "#ffffff", width: 2 }) };
  if (pose.heading_deg === null) return new Style({ image: new Circle({ radius: 7, ...look }) });
  return new Style({
    image: new RegularShape({ points: 3, radius: 15, scale: [0.65, 1], rotation: (pose.heading_deg * Math.PI) / 180, ...look }),
  });
}

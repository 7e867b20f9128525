// Why a cell has its value: what the layers say, and the frames that saw it with their images.

import { containsXY } from "ol/extent";

import type { Block, Bounds, Cell, Mark, SeenBy } from "../data";
import { el, moment, number, plural, swatch } from "../dom";
import { described } from "../marks";
import type { Store } from "../state";
import { QUALITIES, type Row, type Tracks } from "../tracks";
import { poseInWords } from "../timeline";

const SHOWN_FRAMES = 12;
const FIRST_VALUES = ["density", "sigma", "count", "sessions"];

export class EvidencePanel {
  readonly element = el("aside", { id: "evidence", class: "panel", "aria-label": "What is known of a place", hidden: true });
  onHighlight: (frame: SeenBy | null) => void = () => {};
  onClose: () => void = () => {};
  private urls: string[] = [];

  constructor(private readonly store: Store) {}

  close(): void {
    this.forget();
    this.element.hidden = true;
    this.onClose();
  }

  wait(): void {
    this.begin(el("p", { role: "status" }, "Looking…"));
  }

  fail(message: string): void {
    this.begin(el("p", { class: "error" }, message));
  }

  /** What people said of the place. */
  showMarks(marks: Mark[]): void {
    if (!marks.length) return;
    const list = el("ul", { id: "marked" }, ...marks.map((mark) => el("li", {}, described(mark))));
    this.element.querySelector("#verdict")?.after(el("p", {}, "People marked it as:"), list);
  }

  showPose(row: Row, tracks: Tracks): void {
    const track = tracks.ready.get(row.session)!;
    const session = this.store.state.map.sessions[row.session];
    this.element.append(
      el("h3", {}, swatch(session.colour), `Pose of ${session.name}`),
      el("p", { id: "pose" }, poseInWords(track, row.row)),
    );
  }

  showFrame(frame: { session: number; frame_id: string; accepted: boolean; reason: string; time_ms: number }): void {
    const session = this.store.state.map.sessions[frame.session];
    const words = frame.accepted ? "used" : `rejected: ${frame.reason}`;
    this.element.append(
      el("h3", {}, swatch(session.colour), `Frame ${frame.frame_id} of ${session.name}`),
      el("p", { id: "frame" }, `${moment(frame.time_ms)} · ${words}`),
    );
  }

  /** Where the density of a cell is all that is known of it. */
  showValue(density: number | null): void {
    const verdict = this.verdict(density);
    this.begin(
      el("p", { id: "verdict", class: verdict === "Obstacle" ? "obstacle" : "" }, verdict),
      density !== null && el("p", {}, `density ${density} of 255`),
      density !== null && el("p", { class: "says" }, "The frames that saw it are in the map file."),
    );
  }

  private verdict(density: number | null | undefined): string {
    if (density === null || density === undefined) return "Never seen";
    const threshold = this.store.state.map.layers.find((layer) => layer.name === "density")?.obstacle_above ?? 100;
    return density > threshold ? "Obstacle" : density <= 50 ? "Free" : "In doubt";
  }

  show(cell: Cell): void {
    const { verdict, values, frames } = cell;
    const sessions = new Set(frames.map((frame) => frame.session));
    this.begin(
      el("p", { id: "verdict", class: verdict.startsWith("Obstacle") ? "obstacle" : "" }, verdict),
      frames.length
        ? el("p", {}, `Seen by ${plural(frames.length, "frame")} of ${plural(sessions.size, "session")}; ${frames.filter((f) => f.obstacle).length} of them saw an obstacle.`)
        : el("p", {}, "No frame that is switched on saw this cell."),
      this.where(cell),
    );
    if (values.density !== undefined) this.element.append(...this.tables(values));
    if (frames.length) this.element.append(this.frames(cell));
  }

  /** Of a farm the maps that saw the cell, or else those in whose extent it lies. */
  private where({ east_m, north_m, frames }: Cell): HTMLElement | false {
    const { blocks } = this.store.state.map;
    if (!blocks) return false;
    const sessions = new Set(frames.map((frame) => frame.session));
    const seen = blocks.filter((block) => block.sessions.some((number) => sessions.has(number)));
    const around = blocks.filter(({ bounds }) => bounds && containsXY(bounds, east_m, north_m));
    const names = (maps: Block[]) => `${maps.length > 1 ? "the maps" : "the map"} ${maps.map((map) => map.name).join(", ")}`;
    const words = seen.length ? `In ${names(seen)}.` : around.length ? `Within the extent of ${names(around)}.` : "Outside every map.";
    return el("p", { id: "of-maps" }, words);
  }

  private begin(...children: (HTMLElement | false)[]): void {
    this.forget();
    this.element.hidden = false;
    const close = el("button", { type: "button", class: "close", "aria-label": "Close", click: () => this.close() }, "×");
    this.element.replaceChildren(el("h2", { tabindex: -1 }, "Why"), close, ...children.filter((child) => child !== false));
  }

  /** What matters first, with the layer that is shown; the other layers on request. */
  private tables(values: Record<string, number | null>): HTMLElement[] {
    const first = [...new Set([...FIRST_VALUES, this.store.state.layer])].filter((name) => name in values);
    const others = Object.keys(values).filter((name) => !first.includes(name) && name !== "variance");
    const table = (names: string[], id: string) => el("table", { id, class: "values" }, el("tbody", {}, ...names.map((name) => this.row(name, values[name]))));
    return [table(first, "values"), el("details", {}, el("summary", {}, "Other layers"), table(others, "other-values"))];
  }

  private row(name: string, value: number | null): HTMLElement {
    const layer = this.store.state.map.layers.find((one) => one.name === name);
    const title = name === "sigma" ? "sigma of the density" : (layer?.title ?? name);
    const digits = value !== null && Number.isInteger(value) ? 0 : 2;
    const unit = (layer?.unit ?? "").replace(/(?<=\w{4})s$/, value === 1 ? "" : "s"); // 1 session, 2 sessions
    return el("tr", {}, el("th", { scope: "row" }, title), el("td", {}, number(value, digits, unit)));
  }

  private frames(cell: Cell): HTMLElement {
    const dense = (cell.values.density ?? 0) > 50;
    // Those that say most clearly what the cell is come first.
    const frames = [...cell.frames].sort((a, b) => (dense ? b.density - a.density : a.density - b.density));
    const list = el("ol", { class: "frames" });
    const add = (from: number, to: number) => {
      for (const [k, frame] of frames.slice(from, to).entries()) list.append(this.frame(frame, from + k === 0));
    };
    add(0, SHOWN_FRAMES);
    const rest = frames.length - SHOWN_FRAMES;
    const more = el("button", { type: "button", click: () => (add(SHOWN_FRAMES, frames.length), more.remove()) }, `Show ${rest} more`);
    return el("div", {}, el("h3", {}, "Seen by"), list, rest > 0 && more);
  }

  private frame(frame: SeenBy, open: boolean): HTMLElement {
    const session = this.store.state.map.sessions[frame.session];
    const facts = [
      moment(frame.time_ms),
      `heading ${number(frame.heading_deg, 1, "°")} ± ${number(frame.heading_sigma_deg, 2, "°")}`,
      `position ± ${number(frame.position_sigma_m, 3, "m")}`,
      frame.quality === null ? "" : (QUALITIES[frame.quality] ?? ""),
    ].filter(Boolean);
    const images = el("div", { class: "images" });
    const details = el(
      "details",
      { toggle: () => details.open && !images.childElementCount && this.images(images, frame) },
      el(
        "summary",
        {},
        swatch(session.colour),
        el("span", {}, `${session.name} ${frame.frame_id}: `, el("strong", { class: frame.obstacle ? "obstacle" : "" }, frame.density.toFixed(0))),
      ),
      el("p", { class: "says" }, facts.join(" · ")),
      images,
    );
    details.open = open;
    const item = el("li", {}, details);
    for (const event of ["mouseenter", "focusin"]) item.addEventListener(event, () => this.onHighlight(frame));
    for (const event of ["mouseleave", "focusout"]) item.addEventListener(event, () => this.onHighlight(null));
    return item;
  }

  private images(place: HTMLElement, frame: SeenBy): void {
    if (!this.store.source.image || !frame.images.length) {
      place.append(el("p", { class: "says" }, "This frame names no images."));
      return;
    }
    frame.images.forEach((name, k) => place.append(this.image(frame, name, k)));
  }

  private image(frame: SeenBy, name: string, k: number): HTMLElement {
    const which = frame.images.length > 1 ? ["left", "right"][k] : "image";
    const figure = el("figure", {}, el("p", { role: "status" }, "Loading…"));
    this.store.source.image!(this.store.state.map, frame, k).then(
      ({ blob, width_px, height_px }) => {
        const url = URL.createObjectURL(blob);
        this.urls.push(url);
        const picture = el("img", { src: url, alt: `The ${which} image of frame ${frame.frame_id}`, width: width_px, height: height_px });
        const box = frame.places[k];
        figure.replaceChildren(el("div", { class: "photo" }, picture, box && marked(box, width_px, height_px)));
        figure.append(el("figcaption", {}, box ? `${which}: the box is the cell, from the ground up` : `${which}: the cell is outside of it, or its place is not known`));
      },
      (error) => figure.replaceChildren(el("p", { class: "says missing" }, error.message)),
    );
    figure.title = name;
    return figure;
  }

  private forget(): void {
    for (const url of this.urls) URL.revokeObjectURL(url);
    this.urls = [];
    this.onHighlight(null);
  }
}

/** The part of an image in which the cell lies. */
function marked([left, top, right, bottom]: Bounds, width: number, height: number): HTMLElement {
  const box = el("div", { class: "place" });
  box.style.left = `${(100 * left) / width}%`;
  box.style.top = `${(100 * top) / height}%`;
  box.style.width = `${Math.max((100 * (right - left)) / width, 0.6)}%`;
  box.style.height = `${(100 * (bottom - top)) / height}%`;
  return box;
}

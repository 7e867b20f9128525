// What is drawn over the cells: tracks, headings, frames, features, the selected cell.

import Feature from "ol/Feature";
import type OlMap from "ol/Map";
import { intersects } from "ol/extent";
import LineString from "ol/geom/LineString";
import MultiLineString from "ol/geom/MultiLineString";
import MultiPoint from "ol/geom/MultiPoint";
import Point from "ol/geom/Point";
import Polygon, { fromExtent } from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Circle, Fill, RegularShape, Stroke, Style, Text } from "ol/style";

import type { Bounds, Cell, Feature as Told, FeatureTable, Frames, SeenBy, Track } from "./data";
import { markStyle, outline } from "./marks";
import { announce } from "./dom";
import type { Overlay, Store } from "./state";
import { type Row, type Tracks, isHole, usualStep } from "./tracks";

const ARROW_PX = 48;
const FOOTPRINTS_BELOW_M_PX = 0.35;
const SURE = 0.9;
const MOST_TRACKS = 60; // of a farm: more drives at once than these nobody tells apart

export class Drawn {
  private readonly layers = new Map<string, VectorLayer<VectorSource>>();
  private frames: Frames | null = null;
  private drawn: number[] = []; // drives of which tracks are drawn
  private tracks!: Tracks;

  constructor(private readonly map: OlMap, private readonly store: Store) {
    for (const [k, name] of ["blocks", "footprints", "features", "changes", "marks", "tracks", "headings", "frames", "selected", "hover"].entries()) {
      const declutter = name === "blocks"; // small maps side by side: names that would overlap are left out
      const layer = new VectorLayer({ source: new VectorSource({ wrapX: false }), zIndex: 10 + k, declutter });
      this.layers.set(name, layer);
      map.addLayer(layer);
    }
    map.on("moveend", () => {
      this.loadTracks();
      this.drawHeadings();
      void this.loadFrames();
    });
    store.on(["overlays", "sessions"], () => this.redraw());
    store.on(["changed"], () => this.drawChanges());
  }

  /** Begins with the tracks of another map. */
  begin(tracks: Tracks): void {
    this.tracks = tracks;
    this.frames = null;
    for (const layer of this.layers.values()) layer.getSource()!.clear();
    this.redraw();
    this.drawMarks();
    this.drawBlocks();
    this.drawn = [];
    this.loadTracks();
    this.store.source.features(this.store.state.map).then(
      (tables) => this.drawFeatures(tables),
      (error) => announce(error.message, "error"),
    );
  }

  /** Loads the tracks of the drives in sight, and draws each once it is there. */
  private loadTracks(): void {
    const { tracks } = this;
    const wanted = this.sessionsInSight();
    if (wanted.join() === this.drawn.join()) return;
    this.drawn = wanted;
    const drawn = () => {
      if (tracks === this.tracks) this.redraw();
    };
    for (const session of wanted) {
      if (!tracks.ready.has(session)) tracks.load(session).then(drawn, (error) => announce(error.message, "error"));
    }
    this.drawTracks();
  }

  /** The drives of a map; of a farm those of the maps in sight, and none where these are many. */
  private sessionsInSight(): number[] {
    const { sessions, blocks } = this.store.state.map;
    if (!blocks) return sessions.filter((session) => session.active).map((session) => session.number);
    const size = this.map.getSize();
    if (!size) return [];
    const extent = this.map.getView().calculateExtent(size);
    const near = blocks.filter((block) => block.bounds && intersects(block.bounds, extent));
    const found = near.flatMap((block) => block.sessions);
    return found.length > MOST_TRACKS ? [] : found;
  }

  visibleSessions(): number[] {
    const { map, hidden } = this.store.state;
    return map.sessions.filter((s) => s.active && !hidden.has(s.number)).map((s) => s.number);
  }

  private redraw(): void {
    const { visible } = this.store.state;
    for (const name of ["tracks", "headings", "frames", "footprints", "features", "marks", "blocks"] as Overlay[]) {
      this.layers.get(name)!.setVisible(visible[name]);
    }
    this.drawTracks();
    this.drawHeadings();
    void this.loadFrames();
  }

  private source(name: string): VectorSource {
    return this.layers.get(name)!.getSource()!;
  }

  private colour(session: number): string {
    return this.store.state.map.sessions[session].colour;
  }

  private drawTracks(): void {
    const source = this.source("tracks");
    source.clear();
    for (const session of this.visibleSessions()) {
      const track = this.drawn.includes(session) && this.tracks.ready.get(session);
      if (track && track.rows) source.addFeatures(this.trackFeatures(session, track));
    }
  }

  private trackFeatures(session: number, track: Track): Feature[] {
    const { colours } = this.store.state.map;
    const runs = new Map<string, [number, number][][]>();
    const rejected: [number, number][] = [];
    const usual = usualStep(track);
    let run: [number, number][] = [];
    let key = "";
    for (let row = 0; row < track.rows; row++) {
      const place = at(track, row);
      if (!place) continue;
      if (track.status[row] === "rejected") {
        rejected.push(place);
        continue;
      }
      const now = String(track.gear[row]);
      if (now !== key || isHole(track, row, usual)) {
        // On from the last point of the gear before, so that the line is whole.
        const joined = now !== key && run.length && !isHole(track, row, usual) ? [run[run.length - 1]] : [];
        run = joined;
        runs.set(now, [...(runs.get(now) ?? []), run]);
        key = now;
      }
      run.push(place);
    }
    const features: Feature[] = [];
    for (const [gear, lines] of runs) {
      const bySession = this.store.state.colourBy === "session";
      const colour = bySession ? this.colour(session) : (colours.gears[gear] ?? "#000000");
      const feature = new Feature(new MultiLineString(lines.filter((line) => line.length > 1)));
      const width = gear === "-1" ? 4 : 2;
      feature.setStyle([
        new Style({ stroke: new Stroke({ color: "#ffffffcc", width: width + 2 }) }),
        new Style({ stroke: new Stroke({ color: colour, width, lineDash: gear === "-1" && bySession ? [6, 4] : undefined }) }),
      ]);
      features.push(feature);
    }
    if (rejected.length) {
      const feature = new Feature(new MultiPoint(rejected));
      feature.setStyle(
        new Style({
          image: new RegularShape({ points: 4, radius: 4, radius2: 0, angle: Math.PI / 4, stroke: new Stroke({ color: colours.rejected, width: 1.5 }) }),
        }),
      );
      features.push(feature);
    }
    return features;
  }

  /** Arrows along the nose, some pixels apart, for the part of the map that is seen. */
  private drawHeadings(): void {
    const source = this.source("headings");
    source.clear();
    const view = this.map.getView();
    const resolution = view.getResolution();
    if (!this.store.state.visible.headings || !resolution || !this.map.getSize()) return;
    const [west, south, east, north] = view.calculateExtent(this.map.getSize());
    const step = ARROW_PX * resolution;
    for (const session of this.visibleSessions()) {
      const track = this.tracks.ready.get(session);
      if (!track?.rows) continue;
      let last: [number, number] | null = null;
      for (let row = 0; row < track.rows; row++) {
        const place = at(track, row);
        const heading = track.heading_deg[row];
        if (!place || heading === null || track.status[row] === "rejected") continue;
        if (place[0] < west || place[0] > east || place[1] < south || place[1] > north) continue;
        if (last && Math.hypot(place[0] - last[0], place[1] - last[1]) < step) continue;
        last = place;
        const feature = new Feature(new Point(place));
        feature.setStyle(arrow(heading, this.store.state.colourBy === "session" ? this.colour(session) : "#333333"));
        source.addFeature(feature);
      }
    }
  }

  private async loadFrames(): Promise<void> {
    const { visible, map } = this.store.state;
    const size = this.map.getSize();
    const resolution = this.map.getView().getResolution();
    if (!(visible.frames || visible.footprints) || !size || !resolution) {
      this.source("frames").clear();
      this.source("footprints").clear();
      return;
    }
    const extent = this.map.getView().calculateExtent(size) as Bounds;
    try {
      const found = await this.store.source.frames(map, extent, this.store.shownSessions());
      if (map !== this.store.state.map) return;
      this.frames = found;
      this.drawFrames(found, resolution);
    } catch (error) {
      announce((error as Error).message, "error");
    }
  }

  private drawFrames(found: Frames, resolution: number): void {
    const points: Feature[] = [];
    const outlines: Feature[] = [];
    for (let k = 0; k < found.frame_id.length; k++) {
      const place: [number, number] = [found.east_m[k], found.north_m[k]];
      const colour = found.accepted[k] ? this.colour(found.session[k]) : this.store.state.map.colours.rejected;
      const point = new Feature({ geometry: new Point(place), frame: k });
      point.setStyle(
        new Style({
          image: new Circle({
            radius: 4,
            fill: new Fill({ color: found.accepted[k] ? colour : "#ffffff" }),
            stroke: new Stroke({ color: found.accepted[k] ? "#ffffff" : colour, width: 1.5 }),
          }),
        }),
      );
      points.push(point);
      const heading = found.heading_deg[k];
      if (heading !== null && resolution < FOOTPRINTS_BELOW_M_PX) {
        const outline = new Feature(new Polygon([footprint(place, heading, found.width_m[k], found.length_m[k])]));
        outline.setStyle(new Style({ stroke: new Stroke({ color: `${colour}99`, width: 1 }) }));
        outlines.push(outline);
      }
    }
    this.source("frames").clear();
    this.source("frames").addFeatures(points);
    this.source("footprints").clear();
    this.source("footprints").addFeatures(outlines);
  }

  /** The frame that is drawn at a pixel. */
  frameAt(pixel: number[]): { frames: Frames; frame: number } | null {
    const feature = this.map.forEachFeatureAtPixel(pixel, (one) => one, {
      layerFilter: (layer) => layer === this.layers.get("frames"),
      hitTolerance: 4,
    });
    return feature && this.frames ? { frames: this.frames, frame: feature.get("frame") as number } : null;
  }

  private drawMarks(): void {
    const { marks, colours } = this.store.state.map;
    for (const mark of marks.filter((one) => !one.removed)) {
      const feature = new Feature(outline(mark));
      feature.setStyle(markStyle(mark.kind, colours.marks[mark.kind], mark.name));
      this.source("marks").addFeature(feature);
    }
  }

  private drawBlocks(): void {
    const source = this.source("blocks");
    for (const { name, bounds } of this.store.state.map.blocks ?? []) {
      if (!bounds) continue;
      const feature = new Feature(fromExtent(bounds));
      feature.setStyle([
        new Style({ stroke: new Stroke({ color: "#ffffffcc", width: 3 }) }),
        new Style({
          stroke: new Stroke({ color: "#333333", width: 1, lineDash: [6, 4] }),
          text: new Text({ text: name, overflow: true, font: "bold 13px sans-serif", fill: new Fill({ color: "#000000" }), stroke: new Stroke({ color: "#ffffff", width: 4 }) }),
        }),
      ]);
      source.addFeature(feature);
    }
  }

  private drawChanges(): void {
    const source = this.source("changes");
    source.clear();
    for (const object of this.store.state.changed) {
      const casing = new Style({ stroke: new Stroke({ color: "#ffffff", width: 5 }) });
      const line = new Stroke({ color: "#000000", width: 2, lineDash: object.confidence < SURE ? [5, 4] : undefined });
      const text = new Text({ text: object.id, offsetY: -14, overflow: true, font: "bold 13px sans-serif", fill: new Fill({ color: "#000000" }), stroke: new Stroke({ color: "#ffffff", width: 4 }) });
      const middle = [object.east_m, object.north_m];
      const way = object.from ? [new LineString([object.from, middle])] : [];
      for (const geometry of [...shapes(object.geometry), ...way]) {
        const feature = new Feature(geometry);
        feature.setStyle([casing, new Style({ stroke: line })]);
        source.addFeature(feature);
      }
      const label = new Feature(new Point(middle));
      label.setStyle(new Style({ text }));
      source.addFeature(label);
    }
  }

  private drawFeatures(tables: FeatureTable[]): void {
    const source = this.source("features");
    source.clear();
    const { found, route } = this.store.state.map.colours;
    for (const table of tables) {
      const color = found[table.table] ?? route; // none of them that of a session
      for (const one of table.features) {
        for (const geometry of shapes(one.geometry)) {
          const feature = new Feature(geometry);
          const label = one.attributes.name ?? one.attributes.label ?? one.attributes.row;
          feature.setStyle(
            new Style({
              image: new Circle({ radius: 4, fill: new Fill({ color }), stroke: new Stroke({ color: "#ffffff", width: 1.5 }) }),
              stroke: new Stroke({ color, width: 2 }),
              text: label === undefined ? undefined : new Text({ text: String(label), offsetY: -12, fill: new Fill({ color: "#10332a" }), stroke: new Stroke({ color: "#ffffff", width: 3 }) }),
            }),
          );
          source.addFeature(feature);
        }
      }
    }
  }

  /** Shows the selected cell, and of each frame that saw it the wedge from where it stood. */
  select(cell: Cell | null): void {
    const source = this.source("selected");
    source.clear();
    if (!cell) return;
    for (const frame of cell.frames) source.addFeature(this.wedge(frame, cell.bounds, false));
    const [west, south, east, north] = cell.bounds;
    const square = new Feature(new Polygon([[[west, south], [east, south], [east, north], [west, north], [west, south]]]));
    square.setStyle([
      new Style({ stroke: new Stroke({ color: "#ffffff", width: 5 }) }),
      new Style({ stroke: new Stroke({ color: "#000000", width: 2 }) }),
    ]);
    source.addFeature(square);
  }

  /** Marks one of the frames that saw the selected cell. */
  highlight(frame: SeenBy | null, cell: Cell | null): void {
    const source = this.source("hover");
    source.clear();
    if (frame && cell) source.addFeature(this.wedge(frame, cell.bounds, true));
  }

  private wedge(frame: SeenBy, [west, south, east, north]: Bounds, strong: boolean): Feature {
    const colour = this.colour(frame.session);
    const middle = [(west + east) / 2, (south + north) / 2];
    const away = Math.atan2(middle[1] - frame.north_m, middle[0] - frame.east_m) + Math.PI / 2;
    const half = Math.max((east - west) / 2, 0.04 * Math.hypot(middle[0] - frame.east_m, middle[1] - frame.north_m));
    const corner = (side: number) => [middle[0] + side * half * Math.cos(away), middle[1] + side * half * Math.sin(away)];
    const feature = new Feature(new Polygon([[[frame.east_m, frame.north_m], corner(1), corner(-1), [frame.east_m, frame.north_m]]]));
    feature.setStyle(
      new Style({
        fill: new Fill({ color: `${colour}${strong ? "66" : "18"}` }),
        stroke: new Stroke({ color: `${colour}${strong ? "ff" : "70"}`, width: strong ? 2 : 1 }),
      }),
    );
    return feature;
  }

  /** Marks a pose, as the time lines point at it. */
  mark(row: Row | null): void {
    const source = this.source("hover");
    source.clear();
    const track = row && this.tracks.ready.get(row.session);
    const place = track && at(track, row.row);
    if (!row || !track || !place) return;
    const feature = new Feature(new Point(place));
    const heading = track.heading_deg[row.row];
    feature.setStyle([
      new Style({ image: new Circle({ radius: 8, stroke: new Stroke({ color: "#ffffff", width: 5 }) }) }),
      new Style({ image: new Circle({ radius: 8, stroke: new Stroke({ color: "#000000", width: 2 }) }) }),
      ...(heading === null ? [] : [arrow(heading, "#000000")]),
    ]);
    source.addFeature(feature);
  }

}

function shapes(geometry: Told["geometry"]): (Point | LineString | Polygon)[] {
  return geometry.map(([kind, rings]) =>
    kind === 1 ? new Point(rings[0][0]) : kind === 2 ? new LineString(rings[0]) : new Polygon(rings));
}

function at(track: Track, row: number): [number, number] | null {
  const [east, north] = [track.east_m[row], track.north_m[row]];
  return east === null || north === null ? null : [east, north];
}

const arrows = new Map<string, Style>();

function arrow(headingDeg: number, colour: string): Style {
  const rounded = Math.round(headingDeg / 3) * 3;
  const key = `${rounded} ${colour}`;
  let style = arrows.get(key);
  if (!style) {
    style = new Style({
      image: new RegularShape({
        points: 3,
        radius: 7,
        scale: [0.65, 1],
        rotation: (rounded * Math.PI) / 180,
        fill: new Fill({ color: colour }),
        stroke: new Stroke({ color: "#ffffff", width: 1 }),
      }),
    });
    arrows.set(key, style);
  }
  return style;
}

function footprint([east, north]: [number, number], headingDeg: number, width: number, length: number): [number, number][] {
  const phi = (headingDeg * Math.PI) / 180;
  const corners = [[-width / 2, 0], [width / 2, 0], [width / 2, length], [-width / 2, length], [-width / 2, 0]];
  return corners.map(([x, y]) => [
    east + x * Math.cos(phi) + y * Math.sin(phi),
    north - x * Math.sin(phi) + y * Math.cos(phi),
  ]);
}

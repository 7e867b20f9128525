// What people say of places: how it is drawn, and drawing it.

import type OlMap from "ol/Map";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import Draw from "ol/interaction/Draw";
import { Circle, Fill, Stroke, Style, Text } from "ol/style";

import type { MapAbout, Mark, MarkKind, NewMark } from "./data";

export const KINDS: Record<MarkKind, string> = {
  keepout: "keep out",
  free: "this is free",
  obstacle: "this is an obstacle",
  place: "place",
};

const HATCH_PX = 8;
const CLICK_MS = 500;
const hatches = new Map<string, CanvasPattern | string>();

export function outline(mark: NewMark & Partial<Mark>): Point | Polygon {
  if (mark.corners.length === 1) return new Point(mark.corners[0]);
  return new Polygon([mark.corners, ...(mark.holes ?? [])].map((ring) => [...ring, ring[0]]));
}

/** A mark in words. */
export function described(mark: Mark): string {
  const facts = [mark.name && `“${mark.name}”`, mark.note, mark.author && `by ${mark.author}`, mark.created.slice(0, 10)];
  return [KINDS[mark.kind], ...facts].filter(Boolean).join(" · ");
}

/** The marks in force that a place lies in; points within a cell of it. */
export function marksAt(map: MapAbout, east: number, north: number): Mark[] {
  return map.marks.filter((mark) => {
    if (mark.removed) return false;
    if (mark.corners.length > 1) return outline(mark).intersectsCoordinate([east, north]);
    return Math.hypot(mark.corners[0][0] - east, mark.corners[0][1] - north) <= map.cell_m;
  });
}

/** Lines across an area, so that kinds are told apart without their colours. */
function hatch(kind: MarkKind, colour: string): CanvasPattern | string {
  const made = hatches.get(kind);
  if (made) return made;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = HATCH_PX;
  const context = canvas.getContext("2d")!;
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  const lines = kind === "keepout" ? [[0, 8, 8, 0]] : [[0, 8, 8, 0], [0, 0, 8, 8]];
  for (const [x0, y0, x1, y1] of lines) {
    for (const shift of [-HATCH_PX, 0, HATCH_PX]) {
      context.moveTo(x0 + shift, y0);
      context.lineTo(x1 + shift, y1);
    }
  }
  context.stroke();
  const pattern = context.createPattern(canvas, "repeat") ?? `${colour}44`;
  hatches.set(kind, pattern);
  return pattern;
}

export function markStyle(kind: MarkKind, colour: string, name = ""): Style[] {
  const fill = kind === "keepout" || kind === "obstacle" ? hatch(kind, colour) : `${colour}22`;
  return [
    new Style({ stroke: new Stroke({ color: "#ffffffcc", width: 5 }) }),
    new Style({
      fill: new Fill({ color: fill }),
      stroke: new Stroke({ color: colour, width: 2.5 }),
      image: new Circle({ radius: 6, fill: new Fill({ color: colour }), stroke: new Stroke({ color: "#ffffff", width: 2 }) }),
      text: name
        ? new Text({ text: name, offsetY: -12, overflow: true, font: "13px sans-serif", fill: new Fill({ color: colour }), stroke: new Stroke({ color: "#ffffff", width: 4 }) })
        : undefined,
    }),
  ];
}

/** Draws one point or polygon at a time. */
export class Drawing {
  private draw: Draw | null = null;
  private done: ((corners: [number, number][] | null) => void) | null = null;
  private kind: "Point" | "Polygon" = "Point";
  private endedMs = -Infinity;

  constructor(private readonly map: OlMap) {}

  /** Also just after the last click, which the map tells of only once it can be no double click. */
  get active(): boolean {
    return this.draw !== null || performance.now() - this.endedMs < CLICK_MS;
  }

  /** Resolves with the corners, once it is drawn; with null where it is given up. */
  start(kind: "Point" | "Polygon"): Promise<[number, number][] | null> {
    this.stop();
    this.kind = kind;
    this.draw = new Draw({ type: kind });
    this.draw.on("drawend", (event) => {
      const geometry = event.feature.getGeometry() as Point | Polygon;
      const drawn = geometry instanceof Point ? [geometry.getCoordinates()] : geometry.getCoordinates()[0].slice(0, -1);
      this.end(drawn as [number, number][]);
    });
    this.map.addInteraction(this.draw);
    return new Promise((done) => {
      this.done = done;
    });
  }

  /** Adds a corner, as a click there would. */
  corner(place: number[]): void {
    if (this.kind === "Point") this.end([[place[0], place[1]]]);
    else this.draw?.appendCoordinates([place]);
  }

  back(): void {
    this.draw?.removeLastPoint();
  }

  /** Ends a polygon that has enough corners. */
  finish(): void {
    this.draw?.finishDrawing();
  }

  stop(): void {
    this.end(null);
  }

  private end(corners: [number, number][] | null): void {
    const { draw, done } = this;
    this.draw = this.done = null;
    if (draw) {
      this.endedMs = performance.now();
      setTimeout(() => this.map.removeInteraction(draw)); // it is still at its own event
    }
    done?.(corners);
  }
}

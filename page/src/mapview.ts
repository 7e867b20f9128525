// The map: cells, what is drawn over them, where the pointer is, and the ways to move about.

import OlMap from "ol/Map";
import type MapEvent from "ol/MapEvent";
import View from "ol/View";
import ScaleLine from "ol/control/ScaleLine";
import Zoom from "ol/control/Zoom";
import { defaults as interactions } from "ol/interaction/defaults";
import TileLayer from "ol/layer/Tile";
import Projection from "ol/proj/Projection";
import { getRenderPixel } from "ol/render";
import type RenderEvent from "ol/render/Event";

import { cellSource } from "./cells";
import type { Bounds, MapAbout, Shown } from "./data";
import { Drawn } from "./drawn";
import type { Store } from "./state";
import { toGeodetic } from "./plane";
import { Tracks } from "./tracks";

export const plane = new Projection({ code: "fieldgrid-plane", units: "m", extent: [-60_000, -60_000, 60_000, 60_000] });

/** A scale in metres or centimetres: OpenLayers says 1000 mm for a metre. */
export class ScaleBar extends ScaleLine {
  override render(event: MapEvent): void {
    super.render(event);
    const says = this.element?.querySelector(".ol-scale-line-inner");
    const mm = Number(says?.textContent?.match(/^(\d+) mm$/)?.[1] ?? 0);
    if (says && mm >= 10) says.textContent = mm >= 1000 ? `${mm / 1000} m` : `${mm / 10} cm`;
  }
}

export class MapView {
  readonly map: OlMap;
  readonly drawn: Drawn;
  tracks!: Tracks;
  private shown: MapAbout | null = null;
  private readonly cells = new TileLayer({ zIndex: 0 });
  private readonly compared = new TileLayer({ zIndex: 1, visible: false });

  constructor(readonly target: HTMLElement, private readonly readout: HTMLElement, private readonly store: Store) {
    this.map = new OlMap({
      target,
      layers: [this.cells, this.compared],
      controls: [new Zoom({ zoomInTipLabel: "Zoom in", zoomOutTipLabel: "Zoom out" }), new ScaleBar({ minWidth: 80 })],
      interactions: interactions({ altShiftDragRotate: false, pinchRotate: false }),
      keyboardEventTarget: target,
    });
    this.drawn = new Drawn(this.map, store);
    this.compared.on("prerender", (event) => this.clip(event));
    this.compared.on("postrender", (event) => (event.context as CanvasRenderingContext2D).restore());
    this.map.on("pointermove", (event) => this.read(event.coordinate));
    this.map.on("moveend", () => {
      this.read(this.map.getView().getCenter()!);
      target.dataset.extent = this.extent().join(" "); // for who drives the page from outside
    });
    this.map.on("rendercomplete", () => target.setAttribute("aria-busy", "false"));
    store.on(["map"], () => this.begin());
    store.on(["layer", "sessions", "compare"], () => this.refresh());
    store.on(["share"], () => {
      this.compared.setOpacity(store.state.comparing === "fade" ? store.state.share : 1);
      this.begun();
    });
    this.begin();
  }

  /** Shows the map of the store: from where one looked at it, if it was shown before. */
  private begin(): void {
    const { map } = this.store.state;
    const again = this.shown?.name === map.name && this.shown.number === map.number;
    this.shown = map;
    this.tracks = new Tracks(this.store.source, map);
    this.refresh();
    if (!again) this.map.setView(this.view(map));
    if (!again) this.fit(map.bounds);
    this.drawn.begin(this.tracks);
  }

  private view(map: MapAbout): View {
    return new View({
      projection: plane,
      center: [0, 0],
      resolution: 1,
      minResolution: map.cell_m / 40,
      maxResolution: Math.max(map.cell_m * 2 ** (map.levels + 3), 1),
      enableRotation: false,
      constrainResolution: false,
      showFullExtent: true,
    });
  }

  /** Shows all of a rectangle. */
  fit(bounds: Bounds | null): void {
    const [west, south, east, north] = bounds ?? [-10, -10, 10, 10];
    this.map.getView().fit([west, south, east, north], { padding: [24, 24, 48, 24], size: this.map.getSize() });
  }

  /** What is seen of the map. */
  extent(): Bounds {
    return this.map.getView().calculateExtent(this.map.getSize()) as Bounds;
  }

  /** Moves the map where a place is hidden by a panel that lies over it. */
  reveal(place: [number, number], panel: HTMLElement): void {
    this.map.updateSize();
    const pixel = this.map.getPixelFromCoordinate(place);
    const stage = this.target.getBoundingClientRect();
    const over = panel.getBoundingClientRect();
    const free = over.top > stage.top && over.width >= stage.width ? over.top - stage.top : stage.height;
    if (!pixel || (pixel[0] >= 0 && pixel[0] <= stage.width && pixel[1] >= 0 && pixel[1] <= free - 20)) return;
    const view = this.map.getView();
    const shift = (stage.height - free) / 2;
    view.setCenter([place[0], place[1] - shift * view.getResolution()!]);
  }

  private refresh(): void {
    const { map, layer, comparing, before, after, share } = this.store.state;
    const source = (shown: Shown) => cellSource(this.store.source, map, shown, plane);
    if (comparing === "off") {
      this.cells.setSource(source({ layer, sessions: this.store.shownSessions() }));
    } else if (comparing === "change") {
      this.cells.setSource(source({ layer, sessions: null, between: [before, after] }));
    } else {
      this.cells.setSource(source({ layer, sessions: this.store.sessionsAsOf(before) }));
      this.compared.setSource(source({ layer, sessions: this.store.sessionsAsOf(after) }));
    }
    this.compared.setVisible(comparing === "swipe" || comparing === "fade");
    this.compared.setOpacity(comparing === "fade" ? share : 1);
    this.begun();
  }

  /** Says that the map is being drawn anew, until it is. */
  private begun(): void {
    this.target.setAttribute("aria-busy", "true");
    this.map.render();
  }

  /** Draws the later state to the right of the swipe alone. */
  private clip(event: RenderEvent): void {
    const context = event.context as CanvasRenderingContext2D;
    const [width, height] = this.map.getSize() ?? [0, 0];
    const left = this.store.state.comparing === "swipe" ? width * this.store.state.share : 0;
    const corners = [[left, 0], [width, 0], [width, height], [left, height]].map((pixel) => getRenderPixel(event, pixel));
    context.save();
    context.beginPath();
    corners.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.clip();
  }

  private read([east, north]: number[]): void {
    const [lat, lon] = toGeodetic(this.store.state.map.datum, east, north);
    this.readout.textContent =
      `E ${east.toFixed(2)} m  N ${north.toFixed(2)} m   ${lat.toFixed(7)}°, ${lon.toFixed(7)}°`;
  }
}

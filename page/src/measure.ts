// Measuring a way or an area.

import type OlMap from "ol/Map";
import type { EventsKey } from "ol/events";
import { LineString, Polygon } from "ol/geom";
import Draw from "ol/interaction/Draw";
import VectorLayer from "ol/layer/Vector";
import { unByKey } from "ol/Observable";
import VectorSource from "ol/source/Vector";
import { Circle, Fill, Stroke, Style } from "ol/style";

const INK = new Style({
  fill: new Fill({ color: "#0072b222" }),
  stroke: new Stroke({ color: "#0072b2", width: 2, lineDash: [8, 5] }),
  image: new Circle({ radius: 5, fill: new Fill({ color: "#0072b2" }) }),
});

export class Measure {
  private readonly source = new VectorSource({ wrapX: false });
  private draw: Draw | null = null;
  private listening: EventsKey | null = null;

  constructor(private readonly map: OlMap, private readonly say: (text: string) => void) {
    map.addLayer(new VectorLayer({ source: this.source, style: INK, zIndex: 30 }));
  }

  get active(): boolean {
    return this.draw !== null;
  }

  start(kind: "LineString" | "Polygon"): void {
    this.stop();
    this.draw = new Draw({ source: this.source, type: kind, style: INK });
    this.draw.on("drawstart", (event) => {
      this.source.clear();
      const geometry = event.feature.getGeometry()!;
      this.listening = geometry.on("change", () => this.tell(geometry as LineString | Polygon)) as EventsKey;
    });
    this.draw.on("drawend", (event) => this.tell(event.feature.getGeometry() as LineString | Polygon));
    this.map.addInteraction(this.draw);
    this.say(kind === "LineString" ? "Click along the way; double-click ends it." : "Click around the area; double-click ends it.");
  }

  stop(): void {
    if (this.draw) this.map.removeInteraction(this.draw);
    if (this.listening) unByKey(this.listening);
    this.draw = this.listening = null;
    this.source.clear();
    this.say("");
  }

  private tell(geometry: LineString | Polygon): void {
    if (geometry instanceof LineString) {
      this.say(`${geometry.getLength().toFixed(2)} m`);
      return;
    }
    const ring = new LineString(geometry.getCoordinates()[0]);
    const area = geometry.getArea();
    this.say(`${area.toFixed(1)} m²${area >= 1000 ? ` (${(area / 10_000).toFixed(3)} ha)` : ""}, ${ring.getLength().toFixed(1)} m around`);
  }
}



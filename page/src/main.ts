// The page: header, panels, map and time lines, put together.

import "ol/ol.css";
import "uplot/dist/uPlot.min.css";
import "./style.css";

import { type About, type Cell, type Source, Server } from "./data";
import { announce, el } from "./dom";
import { embedded } from "./embedded";
import { follow } from "./live";
import { MapView } from "./mapview";
import { Measure } from "./measure";
import { EvidencePanel } from "./panels/evidence";
import { blocksPanel } from "./panels/blocks";
import { exportDialog } from "./panels/export";
import { layersPanel } from "./panels/layers";
import { Drawing, marksAt } from "./marks";
import { marksPanel } from "./panels/marks";
import { comparePanel, sessionsPanel } from "./panels/sessions";
import { Store, initial } from "./state";
import { Timeline } from "./timeline";

const TOKEN = "fieldgrid-token";
const POSE_PX = 8;

async function start(): Promise<void> {
  document.body.append(el("div", { id: "announcements", role: "status", "aria-live": "polite" }));
  if (document.documentElement.dataset.page === "live") {
    await follow(token());
    return;
  }
  const source: Source = embedded() ?? new Server(token());
  try {
    build(await source.about(), source);
  } catch (error) {
    announce((error as Error).message, "error");
  }
}

/** The token of the link, kept for reloads of this tab and taken out of the address. */
function token(): string {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(TOKEN) ?? "";
}

function build(about: About, source: Source): void {
  const store = new Store(source, initial(about.maps[0]));
  const readout = el("output", { id: "readout", "aria-label": "Position" });
  const target = el("div", { id: "map", tabindex: 0, role: "application", "aria-label": "Map. Arrow keys move it, plus and minus zoom, Enter asks why the cell in the middle has its value." });
  const tool = el("output", { id: "tool-says", "aria-live": "polite" });
  const panels = el("nav", { id: "panels", class: "panel", "aria-label": "What is shown" }, layersPanel(store), blocksPanel(store, (bounds) => view.fit(bounds)), sessionsPanel(store, about.writable ? again : null), marksPanel(store, about.writable ? again : null, draw, (bounds) => view.fit(bounds)), source.cell && comparePanel(store, () => view.extent(), (bounds) => view.fit(bounds)));
  const evidence = new EvidencePanel(store);
  let tracks: MapView;
  const timeline = new Timeline(store, () => tracks.tracks);

  const choice = el("select", { id: "map-choice", "aria-label": "Map", change: () => pick(Number(choice.value)) });
  choice.append(...about.maps.map((map) => el("option", { value: map.number }, map.name)));
  const button = (id: string, text: string, act: () => void, pressed = false) =>
    el("button", { id, type: "button", "aria-pressed": pressed, click: act }, text);
  const showPanels = button("show-panels", "Layers", () => setPanels(panels.matches("[hidden]")));
  const showTimeline = button("show-timeline", "Time lines", () => {
    const seen = view.extent();
    timeline.toggle(!timeline.shown);
    view.map.updateSize();
    if (timeline.shown) view.fit(seen); // on a map that is now less high
    showTimeline.setAttribute("aria-pressed", String(timeline.shown));
  });
  const length = button("measure-length", "Distance", () => toggleMeasure("LineString"));
  const area = button("measure-area", "Area", () => toggleMeasure("Polygon"));
  const finish = el("button", { id: "finish", type: "button", hidden: true, click: () => drawing.finish() }, "Finish");
  const cancel = el("button", { id: "cancel", type: "button", hidden: true, click: () => drawing.stop() }, "Cancel");
  const fit = el("button", { id: "fit", type: "button", click: () => view.fit(store.state.map.bounds) }, "Whole field");
  const saving = el("button", { id: "export", type: "button", click: () => void exportDialog(store, view, about.formats) }, "Export");
  const theme = el("button", { id: "theme", type: "button", "aria-label": "Light or dark", click: () => changeTheme() }, "◐");

  document.title = `${about.maps[0].name} · fieldgrid`;
  document.body.append(
    el("header", {}, el("h1", {}, "fieldgrid"), about.maps.length > 1 ? choice : el("span", { class: "name" }, about.maps[0].name),
      el("div", { class: "buttons" }, showPanels, showTimeline, length, area, fit, source.actions && saving, theme)),
    el("main", {}, panels, el("div", { id: "stage" }, target, el("div", { id: "tool" }, tool, finish, cancel), readout), evidence.element),
    timeline.element,
  );
  setPanels(!matchMedia("(max-width: 700px)").matches);

  const view = new MapView(target, readout, store);
  tracks = view;
  const measure = new Measure(view.map, (text) => {
    tool.textContent = text;
  });
  const drawing = new Drawing(view.map);
  let cell: Cell | null = null;
  let asked = 0;

  timeline.onHover = (row) => view.drawn.mark(row);
  evidence.onHighlight = (frame) => view.drawn.highlight(frame, cell);
  evidence.onClose = () => {
    cell = null;
    view.drawn.select(null);
    target.focus();
  };
  view.map.on("singleclick", (event) => {
    if (!measure.active && !drawing.active) void ask(event.coordinate, event.pixel);
  });
  view.map.on("pointermove", (event) => {
    if (event.dragging || !timeline.shown) return;
    const within = POSE_PX * view.map.getView().getResolution()!;
    const row = view.tracks.nearest(event.coordinate[0], event.coordinate[1], within, view.drawn.visibleSessions());
    timeline.point(row);
    if (row) view.drawn.mark(row);
  });
  target.addEventListener("keydown", (event) => {
    if (drawing.active) {
      if (event.key === "Enter") drawing.corner(view.map.getView().getCenter()!);
      if (event.key === "Backspace") drawing.back();
    } else if (event.key === "Enter") {
      const size = view.map.getSize()!;
      void ask(view.map.getView().getCenter()!, [size[0] / 2, size[1] / 2]);
    }
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    if (drawing.active) drawing.stop();
    else if (measure.active) endMeasure();
    else if (!evidence.element.hidden) evidence.close();
  });
  store.on(["sessions", "compare"], () => {
    if (cell) void ask([cell.east_m, cell.north_m], null);
  });

  async function ask([east, north]: number[], pixel: number[] | null): Promise<void> {
    const number = ++asked;
    evidence.wait();
    try {
      const found = source.cell && (await source.cell(store.state.map, east, north, store.shownSessions()));
      const value = source.value && (await source.value(store.state.map, east, north));
      if (number !== asked) return; // another place was asked about meanwhile
      if (found) {
        cell = found;
        view.drawn.select(cell);
        evidence.show(cell);
      } else evidence.showValue(value);
      evidence.showMarks(marksAt(store.state.map, east, north));
      requestAnimationFrame(() => view.reveal([east, north], evidence.element));
      const frame = pixel && view.drawn.frameAt(pixel);
      if (frame) {
        const { frames, frame: k } = frame;
        evidence.showFrame({ session: frames.session[k], frame_id: frames.frame_id[k], accepted: frames.accepted[k], reason: frames.reason[k], time_ms: frames.time_ms[k] });
      }
      const within = POSE_PX * view.map.getView().getResolution()!;
      const row = view.tracks.nearest(east, north, within, view.drawn.visibleSessions());
      if (row) evidence.showPose(row, view.tracks);
    } catch (error) {
      if (number === asked) evidence.fail((error as Error).message);
    }
  }

  /** Shows the map as it is now: after a change. */
  async function again(): Promise<void> {
    const { number } = store.state.map;
    about.maps = (await source.about()).maps;
    evidence.close();
    const { layer, colourBy, visible } = store.state;
    store.change("map", { ...initial(about.maps[number]), layer, colourBy, visible });
  }

  function pick(number: number): void {
    evidence.close();
    store.change("map", initial(about.maps[number]));
    document.title = `${store.state.map.name} · fieldgrid`;
  }

  function setPanels(shown: boolean): void {
    panels.hidden = !shown;
    showPanels.setAttribute("aria-pressed", String(shown));
  }

  /** Lets a point or a polygon be drawn; null where that was given up. */
  async function draw(kind: "Point" | "Polygon"): Promise<[number, number][] | null> {
    endMeasure();
    drawing.stop();
    if (matchMedia("(max-width: 700px)").matches) setPanels(false);
    tool.textContent = kind === "Point"
      ? "Click or tap the place; or move the map and press Enter for its middle."
      : "Click or tap around the area, then Finish; or move the map and press Enter for its middle.";
    finish.hidden = kind === "Point";
    cancel.hidden = false;
    target.focus();
    const corners = await drawing.start(kind);
    tool.textContent = "";
    finish.hidden = cancel.hidden = true;
    return corners;
  }

  function toggleMeasure(kind: "LineString" | "Polygon"): void {
    const on = kind === "LineString" ? length : area;
    const was = on.getAttribute("aria-pressed") === "true";
    endMeasure();
    drawing.stop();
    if (was) return;
    on.setAttribute("aria-pressed", "true");
    measure.start(kind);
  }

  function endMeasure(): void {
    measure.stop();
    length.setAttribute("aria-pressed", "false");
    area.setAttribute("aria-pressed", "false");
  }

  function changeTheme(): void {
    const dark = getComputedStyle(document.documentElement).colorScheme.trim() === "dark";
    document.documentElement.dataset.theme = dark ? "light" : "dark";
    timeline.draw();
  }
}

void start();

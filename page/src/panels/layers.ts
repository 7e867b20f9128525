// Which layer is shown, what its colours mean, and what is drawn over it.

import type { Layer, Scale } from "../data";
import { announce, el, number, swatch } from "../dom";
import { gradient } from "../ramp";
import type { Overlay, Store } from "../state";
import { GEARS } from "../tracks";

const OVERLAYS: Record<Overlay, string> = {
  tracks: "Trajectories",
  headings: "Headings",
  frames: "Frames",
  footprints: "Footprints (when near)",
  features: "Rows, routes and other features",
  marks: "Keep-outs, corrections, places",
  blocks: "Maps of the farm",
};

export function layersPanel(store: Store): HTMLElement {
  const choice = el("select", { id: "layer", change: () => store.change("layer", { layer: choice.value }) });
  const legend = el("div", { id: "legend" });
  const overlays = el("fieldset", {}, el("legend", {}, "Over it"));
  const colours = el(
    "select",
    {
      id: "colour-by",
      change: () => store.change("overlays", { colourBy: colours.value as "gear" | "session" }),
    },
    el("option", { value: "gear" }, "gear"),
    el("option", { value: "session" }, "session"),
  );
  const gears = el("div", { class: "swatches", id: "gears" });

  for (const [name, title] of Object.entries(OVERLAYS) as [Overlay, string][]) {
    const box = el("input", {
      type: "checkbox",
      id: `overlay-${name}`,
      change: () => store.change("overlays", { visible: { ...store.state.visible, [name]: box.checked } }),
    });
    box.checked = store.state.visible[name];
    overlays.append(el("label", { class: "check", id: `choice-${name}` }, box, title));
  }
  overlays.append(el("label", { class: "row" }, "Trajectories by", colours), gears);

  function drawGears(): void {
    const { map, colourBy } = store.state;
    colours.value = colourBy;
    const items = colourBy === "gear"
      ? Object.entries(map.colours.gears).map(([gear, colour]) => el("span", {}, swatch(colour, "line"), GEARS[gear]))
      : map.sessions.filter((s) => s.active).slice(0, 8).map((s) => el("span", {}, swatch(s.colour, "line"), s.name));
    gears.replaceChildren(...items, el("span", {}, swatch(map.colours.rejected, "cross"), "rejected"));
  }

  function begin(): void {
    const { layers } = store.state.map;
    const subjects = [...new Set(layers.map((layer) => layer.subject))];
    choice.replaceChildren(...subjects.map((subject) =>
      el("optgroup", { label: subject }, ...layers
        .filter((layer) => layer.subject === subject)
        .map((layer) => el("option", { value: layer.name }, layer.title)))));
    choice.value = store.state.layer;
    overlays.querySelector<HTMLElement>("#choice-blocks")!.hidden = !store.state.map.blocks;
    drawGears();
    void drawLegend();
  }

  async function drawLegend(): Promise<void> {
    const { map, layer: name, comparing } = store.state;
    choice.disabled = comparing === "change";
    if (comparing === "change") {
      const kinds = map.changes.slice(1).map((kind) => el("span", {}, swatch(kind.colour), kind.says));
      legend.replaceChildren(el("div", { class: "swatches column" }, ...kinds, unseen()));
      return;
    }
    const layer = map.layers.find((one) => one.name === name)!;
    try {
      const scale = await store.source.scale(map, name);
      if (store.state.layer === name && store.state.comparing !== "change") legend.replaceChildren(...described(layer, scale));
    } catch (error) {
      announce((error as Error).message, "error");
    }
  }

  store.on(["map"], begin);
  store.on(["layer", "compare"], () => void drawLegend());
  store.on(["overlays"], drawGears);
  begin();
  return el(
    "details",
    { open: true, id: "layers" },
    el("summary", {}, "Layers"),
    el("label", { class: "row", for: "layer" }, "Cells", choice),
    legend,
    overlays,
  );
}

function described(layer: Layer, scale: Scale): HTMLElement[] {
  const bar = el("div", { class: "ramp", role: "img", "aria-label": `Colours from ${scale.low} to ${scale.high}` });
  bar.style.background = gradient(layer.ramp);
  const digits = scale.high - scale.low >= 20 ? 0 : 2;
  const ends = [el("span", {}, number(scale.low, digits, layer.unit)), el("span", {}, number(scale.high, digits, layer.unit))];
  if (layer.obstacle_above !== null) {
    ends.splice(1, 0, el("span", {}, `free – in doubt | above ${layer.obstacle_above}: obstacle`));
  }
  return [el("p", { class: "says" }, layer.says), bar, el("div", { class: "ends" }, ...ends), unseen()];
}

function unseen(): HTMLElement {
  return el("div", { class: "swatches" }, el("span", {}, el("span", { class: "swatch unseen", "aria-hidden": "true" }), "never seen"));
}

// The maps of a farm: where each is, what it has, and why one cannot be read.

import type { Block, Bounds } from "../data";
import { el, plural } from "../dom";
import type { Store } from "../state";

const AWAY_M = 0.5;

/** `show` brings a part of the farm into sight; nothing is listed for a map. */
export function blocksPanel(store: Store, show: (bounds: Bounds) => void): HTMLElement {
  const list = el("ul", { class: "sessions", id: "block-list" });
  const panel = el("details", { id: "blocks", open: true }, el("summary", {}, "Maps"), list);

  function item(block: Block): HTMLElement {
    const facts = [`${(block.area_m2 / 1e4).toFixed(2)} ha seen`, plural(block.sessions.length, "drive")];
    if (block.datum_away_m > AWAY_M) facts.push(`its datum is ${block.datum_away_m.toFixed(0)} m away`);
    const { bounds } = block;
    return el(
      "li",
      { class: block.problem ? "removed" : "" },
      bounds
        ? el("button", { type: "button", class: "plain", title: "Show it", click: () => show(bounds) }, el("strong", {}, block.name), el("small", {}, facts.join(" · ")))
        : el("span", { class: "plain" }, el("strong", {}, block.name), el("small", {}, block.problem || "It has seen nothing.")),
    );
  }

  function draw(): void {
    const { blocks } = store.state.map;
    panel.hidden = !blocks;
    list.replaceChildren(...(blocks ?? []).map(item));
  }

  store.on(["map"], draw);
  draw();
  return panel;
}

// Keep-outs, corrections and places: a list, and what draws more of them or takes them out.

import { boundingExtent } from "ol/extent";

import type { Bounds, Mark, MarkKind } from "../data";
import { announce, ask, el, swatch } from "../dom";
import { KINDS, described } from "../marks";
import type { Store } from "../state";

const AUTHOR = "fieldgrid-author";
const NEAR_M = 5;

/** `changed` is called once marks have changed, null where nothing may be changed; `draw` lets a
 * point or polygon be drawn; `show` brings a part of the map into sight. */
export function marksPanel(
  store: Store,
  changed: (() => Promise<void>) | null,
  draw: (kind: "Point" | "Polygon") => Promise<[number, number][] | null>,
  show: (bounds: Bounds) => void,
): HTMLElement {
  const list = el("ul", { class: "sessions", id: "mark-list" });
  const none = el("p", { class: "says" }, "Nothing is marked.");

  function fill(): void {
    const { marks, colours, blocks } = store.state.map;
    buttons.hidden = !changed || blocks !== null;
    none.hidden = marks.length > 0;
    list.replaceChildren(
      ...marks.map((mark) =>
        el(
          "li",
          { class: mark.removed ? "removed" : "" },
          swatch(colours.marks[mark.kind]),
          el("button", { type: "button", class: "plain", title: "Show it", click: () => reveal(mark) }, el("strong", {}, mark.name || KINDS[mark.kind]), el("small", {}, mark.removed ? `${described(mark)} · removed` : described(mark))),
          changed && !blocks && el("button", { type: "button", click: () => void act(mark) }, mark.removed ? "Restore" : "Remove"),
        ),
      ),
    );
  }

  function reveal(mark: Mark): void {
    const [west, south, east, north] = boundingExtent(mark.corners);
    show([west - NEAR_M, south - NEAR_M, east + NEAR_M, north + NEAR_M]);
  }

  async function act(mark: Mark): Promise<void> {
    const says = mark.name || KINDS[mark.kind];
    const [action, title, words] = mark.removed
      ? (["restore", `Restore ${says}?`, "It will count again, as it was."] as const)
      : (["remove", `Remove ${says}?`, "The map will be as if it had never been marked. The mark is kept, and it can be restored."] as const);
    if (!(await ask(title, mark.removed ? "Restore" : "Remove", el("p", {}, words)))) return;
    await done(store.source.actions!.changeMark(store.state.map, action, mark.id), `${says} ${action}d.`);
  }

  async function add(shape: "Point" | "Polygon"): Promise<void> {
    const corners = await draw(shape);
    if (!corners) return;
    const kinds = Object.entries(KINDS).filter(([kind]) => shape === "Polygon" || kind !== "keepout");
    const field = (name: string, title: string, value = "") =>
      el("label", { class: "row", for: `mark-${name}` }, title, el("input", { id: `mark-${name}`, type: "text", name, value, maxlength: 500 }));
    const name = field("name", "Name");
    const kind = el("select", { id: "mark-kind", name: "kind", change: () => (name.querySelector("input")!.required = kind.value === "place") },
      ...kinds.map(([value, title]) => el("option", { value }, title)));
    const what = shape === "Point" ? "The cell at the point" : `The area of ${corners.length} corners`;
    const form = await ask(
      "Mark this?",
      "Mark",
      el("p", {}, `${what} will count so in routes, costs and exports, until the mark is removed. What the drives saw stays as it is.`),
      el("label", { class: "row", for: "mark-kind" }, "It says", kind),
      name,
      field("note", "Why"),
      field("author", "By", localStorage.getItem(AUTHOR) ?? ""),
    );
    if (!form) return;
    const text = (name: string) => String(form.get(name) ?? "");
    localStorage.setItem(AUTHOR, text("author"));
    const mark = { kind: text("kind") as MarkKind, corners, name: text("name"), note: text("note"), author: text("author") };
    await done(store.source.actions!.addMark(store.state.map, mark), "Marked; Remove in the list undoes it.");
  }

  async function done(change: Promise<void>, says: string): Promise<void> {
    try {
      await change;
      await changed!();
      announce(says);
    } catch (error) {
      announce((error as Error).message, "error");
    }
  }

  const buttons = el("div", { class: "mark-buttons" },
    el("button", { id: "mark-area", type: "button", click: () => void add("Polygon") }, "Draw an area"),
    el("button", { id: "mark-point", type: "button", click: () => void add("Point") }, "Mark a point"));
  store.on(["map"], fill);
  fill();
  return el(
    "details",
    { id: "marks", open: true },
    el("summary", {}, "Marks"),
    changed && buttons,
    none,
    list,
  );
}

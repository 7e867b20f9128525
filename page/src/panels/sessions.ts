// The drives of a map: which are shown, and two moments beside each other.

import type { Bounds, ChangedObject, Session } from "../data";
import { announce, ask, el, plural, swatch } from "../dom";
import type { Comparing, Store } from "../state";

/** `changed` is called once a session was taken out or put back; null where nothing may be changed. */
export function sessionsPanel(store: Store, changed: (() => Promise<void>) | null): HTMLElement {
  const list = el("ul", { class: "sessions" });

  function draw(): void {
    const { map, hidden } = store.state;
    const mapOf = new Map(map.blocks?.flatMap((block) => block.sessions.map((number) => [number, `map ${block.name}`] as const)));
    list.replaceChildren(
      ...map.sessions.map((session) => {
        const id = `session-${session.number}`;
        const box = el("input", { type: "checkbox", id, disabled: !session.active, change: () => toggle(session.number, box.checked) });
        box.checked = session.active && !hidden.has(session.number);
        const refused = session.frames - session.accepted;
        const facts = session.active
          ? `${session.driven} · ${plural(session.accepted, "frame")} used${refused ? `, ${refused} rejected` : ""}`
          : `${session.driven} · removed`;
        return el(
          "li",
          { class: session.active ? "" : "removed" },
          box,
          swatch(session.colour),
          el("label", { for: id }, el("strong", {}, session.name), el("small", {}, facts), el("small", {}, mapOf.get(session.number) ?? session.source)),
          changed && !map.blocks && el("button", { type: "button", click: () => void act(session) }, session.active ? "Remove" : "Restore"),
        );
      }),
    );
  }

  function toggle(number: number, shown: boolean): void {
    const hidden = new Set(store.state.hidden);
    if (shown) hidden.delete(number);
    else hidden.add(number);
    store.change("sessions", { hidden });
  }

  async function act(session: Session): Promise<void> {
    const [action, title, words] = session.active
      ? (["remove", `Remove ${session.name}?`, "The map will be as if this drive had never been in it. Its evidence is kept, and it can be restored."] as const)
      : (["restore", `Restore ${session.name}?`, "The map will be as if this drive had never been taken out."] as const);
    if (!(await ask(title, session.active ? "Remove" : "Restore", el("p", {}, words)))) return;
    try {
      await store.source.actions!.changeSession(store.state.map, action, session.name);
      await changed!();
      announce(`${session.name} ${session.active ? "removed" : "restored"}.`);
    } catch (error) {
      announce((error as Error).message, "error");
    }
  }

  store.on(["map"], draw);
  draw();
  return el("details", { id: "sessions", open: true }, el("summary", {}, "Sessions"), list);
}

const MODES: Record<Comparing, string> = {
  off: "one state",
  swipe: "swipe between two",
  fade: "fade between two",
  change: "what changed",
};

const KINDS: Record<ChangedObject["kind"], string> = {
  appeared: "appeared",
  vanished: "vanished",
  moved: "moved",
  grown: "grown",
  cut_back: "cut back",
};

const MOST_CELLS = 20e6; // of a map that is looked through as a whole
const AROUND_M = 3;

/** `seen` is the part of the map that is on the screen, and `fit` shows another. */
export function comparePanel(store: Store, seen: () => Bounds, fit: (bounds: Bounds) => void): HTMLElement {
  const mode = el(
    "select",
    { id: "compare-mode", change: () => changed() },
    ...Object.entries(MODES).map(([value, title]) => el("option", { value }, title)),
  );
  const before = el("select", { id: "compare-before", change: () => changed() });
  const after = el("select", { id: "compare-after", change: () => changed() });
  const share = el("input", {
    type: "range", id: "compare-share", min: 0, max: 100, value: 50,
    input: () => store.change("share", { share: Number(share.value) / 100 }),
  });
  const moments = el(
    "div",
    {},
    el("label", { class: "row", for: "compare-before" }, "As of", before),
    el("label", { class: "row", for: "compare-after" }, "and as of", after),
  );
  const slider = el("label", { class: "row", for: "compare-share" }, "Between them", share);
  const note = el("p", { class: "says" });
  const objects = el("ol", { id: "change-list", class: "changes" });
  const here = el("button", { type: "button", id: "change-here", click: () => void find(seen()) }, "Find changed objects here");
  let asked = 0;

  /** Looks for changed objects in the whole of a small map, and where it is said of a large one. */
  async function find(bounds: Bounds | null): Promise<void> {
    const { map, before, after, comparing } = store.state;
    const number = ++asked;
    store.change("changed", { changed: [] });
    objects.replaceChildren();
    const [west, south, east, north] = map.bounds ?? [0, 0, 0, 0];
    const isLarge = (east - west) * (north - south) > MOST_CELLS * map.cell_m ** 2;
    here.hidden = comparing !== "change" || !isLarge;
    if (comparing !== "change" || (isLarge && !bounds)) return;
    note.textContent = "Looking for changed objects …";
    try {
      const found = await store.source.changes!(map, before, after, isLarge ? bounds : null);
      if (number !== asked) return;
      note.textContent = found.length ? plural(found.length, "changed object") : "No object changed; what differs is within what positions and views explain.";
      objects.replaceChildren(...found.map(item));
      store.change("changed", { changed: found });
    } catch (error) {
      if (number === asked) note.textContent = (error as Error).message;
    }
  }

  function item(object: ChangedObject): HTMLElement {
    const { east_m: east, north_m: north } = object;
    const facts = [`${object.length_m.toFixed(1)} x ${object.width_m.toFixed(1)} m`, `${object.area_m2.toFixed(2)} m²`, `${Math.floor(object.confidence * 100)} % sure`];
    const show = () => fit([east - AROUND_M, north - AROUND_M, east + AROUND_M, north + AROUND_M]);
    const drives = `stood: ${object.stood.join(", ") || "–"} · free: ${object.freed.join(", ") || "–"}`;
    return el("li", {}, el("button", { type: "button", click: show }, `${object.id} ${KINDS[object.kind]}`), el("small", {}, facts.join(" · ")), el("small", {}, drives));
  }

  function begin(): void {
    const { map } = store.state;
    for (const [choice, chosen] of [[before, store.state.before], [after, store.state.after]] as const) {
      choice.replaceChildren(
        ...map.order.map((number) => {
          const session = map.sessions[number];
          return el("option", { value: number }, `${session.driven} ${session.name}`);
        }),
      );
      choice.value = String(chosen);
    }
    mode.querySelector<HTMLOptionElement>("[value=change]")!.disabled = map.blocks !== null;
    mode.disabled = map.order.length < 2;
    note.textContent = map.order.length < 2 ? "A map of one session has one state; append a drive to compare." : "";
    mode.value = store.state.comparing;
    layout();
    void find(null);
  }

  function changed(): void {
    const [first, second] = [Number(before.value), Number(after.value)];
    const { order } = store.state.map;
    const comparing = mode.value as Comparing;
    if (comparing === "change" && order.indexOf(first) >= order.indexOf(second)) {
      note.textContent = "A change needs a second moment that is later than the first.";
      return;
    }
    note.textContent = "";
    store.change("compare", { comparing, before: first, after: second });
    layout();
    void find(null);
  }

  function layout(): void {
    moments.hidden = mode.value === "off";
    slider.hidden = mode.value !== "swipe" && mode.value !== "fade";
  }

  store.on(["map"], begin);
  begin();
  return el(
    "details",
    { id: "compare" },
    el("summary", {}, "Compare"),
    el("label", { class: "row", for: "compare-mode" }, "Show", mode),
    moments,
    slider,
    note,
    here,
    objects,
  );
}

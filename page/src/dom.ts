// Elements made in one call, and numbers as text.

type Child = Node | string | null | undefined | false;
type Attributes = Record<string, string | number | boolean | undefined | ((event: Event) => void)>;

/** An element with attributes and children; an attribute that is a function listens to the event of its name. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== undefined && value !== false) made.setAttribute(name, String(value));
  }
  made.append(...children.filter((child): child is Node | string => Boolean(child)));
  return made;
}

/** A swatch of a colour, whose meaning stands beside it. */
export function swatch(colour: string, kind = ""): HTMLElement {
  const made = el("span", { class: `swatch ${kind}`, "aria-hidden": "true" });
  made.style.setProperty("--colour", colour);
  return made;
}

/** A number with its unit, or a dash where it is not known. */
export function number(value: number | null | undefined, digits: number, unit = ""): string {
  if (value === null || value === undefined) return "–";
  return `${value.toFixed(digits)}${unit && " "}${unit}`;
}

/** A moment of UTC, to the second. */
export function moment(ms: number): string {
  return new Date(ms).toISOString().slice(0, 19).replace("T", " ") + " UTC";
}

export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count.toLocaleString("en")} ${count === 1 ? one : many}`;
}

/** Says something to those who look and to those who listen. */
export function announce(text: string, kind: "note" | "error" = "note"): void {
  const place = document.getElementById("announcements");
  if (!place) return;
  const note = el("p", { class: kind }, text);
  place.replaceChildren(note);
  if (kind === "note") setTimeout(() => note.remove(), 8000);
}

/** Asks before something is done; resolves with the form's values, or null when it is not to be done. */
export function ask(title: string, yes: string, ...content: Child[]): Promise<FormData | null> {
  return new Promise((done) => {
    const form = el(
      "form",
      { method: "dialog" },
      el("h2", { id: "dialog-title" }, title),
      ...content,
      el(
        "div",
        { class: "dialog-buttons" },
        el("button", { value: "no", formnovalidate: true }, "Cancel"),
        el("button", { value: "yes", class: "primary" }, yes),
      ),
    );
    const dialog = el("dialog", { "aria-labelledby": "dialog-title" }, form);
    dialog.addEventListener("close", () => {
      done(dialog.returnValue === "yes" ? new FormData(form) : null);
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

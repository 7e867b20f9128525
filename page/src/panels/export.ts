// What is seen as a file for other programs.

import type { About } from "../data";
import { announce, ask, el } from "../dom";
import type { MapView } from "../mapview";
import type { Store } from "../state";

/** Asks for a format and a part, and saves the file. */
export async function exportDialog(store: Store, view: MapView, formats: About["formats"]): Promise<void> {
  const { map, layer, hidden } = store.state;
  const format = el("select", { name: "format", id: "export-format" }, ...formats.map((one) => el("option", { value: one.name }, `${one.name}: ${one.says}`)));
  const part = el("select", { name: "part", id: "export-part" }, el("option", { value: "seen" }, "what is seen now"), el("option", { value: "all" }, "the whole map"));
  const cell = el("input", { type: "text", inputmode: "decimal", name: "cell", id: "export-cell", value: map.cell_m, pattern: "[0-9]*[.]?[0-9]+" });
  const answers = await ask(
    "Export",
    "Export",
    el("label", { class: "row", for: "export-format" }, "Format", format),
    el("label", { class: "row", for: "export-part" }, "Part", part),
    el("label", { class: "row", for: "export-cell" }, "Cell (m)", cell),
    el("p", { class: "says" }, `Layer ${layer}, all sessions${hidden.size ? ", those that are switched off too" : ""}.`),
  );
  if (!answers) return;
  announce("Exporting…");
  try {
    const { blob, name } = await store.source.actions!.export(map, {
      format: String(answers.get("format")),
      layer,
      bounds: answers.get("part") === "seen" ? view.extent() : null,
      cell_m: Number(answers.get("cell")),
    });
    const url = URL.createObjectURL(blob);
    el("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
    announce(`Saved ${name}.`);
  } catch (error) {
    announce((error as Error).message, "error");
  }
}

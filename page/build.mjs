// Builds the page into src/fieldgrid/view/static, from which `fieldgrid view` serves it.
//
// The first line of viewer.js holds the SHA-256 of everything that it is built from, so that a test
// can tell that the built files are those of the sources, without npm.

import { createHash } from "node:crypto";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "..", "src", "fieldgrid", "view", "static");

const sources = ["build.mjs", "package.json", "package-lock.json", "tsconfig.json"].concat(
  readdirSync(join(here, "src"), { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => join(entry.parentPath, entry.name).slice(here.length + 1).replaceAll("\\", "/")),
);
const hash = createHash("sha256");
for (const name of sources.sort()) {
  hash.update(`${name}\n`).update(readFileSync(join(here, name))).update("\n");
}

mkdirSync(out, { recursive: true });
const result = await build({
  absWorkingDir: here,
  entryPoints: { viewer: "src/main.ts" },
  outdir: out,
  bundle: true,
  minify: true,
  format: "iife",
  target: ["chrome100", "firefox100", "safari15.4"],
  legalComments: "none",
  metafile: true,
  banner: { js: `// built from ${hash.digest("hex")}; licences in licences.txt` },
});
for (const name of ["index.html", "live.html"]) {
  copyFileSync(join(here, "src", name), join(out, name));
}

// The licence of every package of which something is in the bundle.
const packages = new Set(
  Object.keys(result.metafile.inputs)
    .map((path) => path.match(/node_modules\/((?:@[^/]+\/)?[^/]+)\//)?.[1])
    .filter(Boolean),
);
const licences = [...packages].sort().map((name) => {
  const folder = join(here, "node_modules", name);
  const about = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = readdirSync(folder).find((entry) => /^licen[cs]e/i.test(entry));
  if (file === undefined) throw new Error(`${name} has no licence file`);
  const text = readFileSync(join(folder, file), "utf8").trim();
  return `${name} ${about.version} (${about.license})\n\n${text}\n`;
});
writeFileSync(
  join(out, "licences.txt"),
  `viewer.js and viewer.css contain code of these packages.\n\n${licences.join(`\n${"-".repeat(72)}\n\n`)}`,
);
for (const [path, { bytes }] of Object.entries(result.metafile.outputs)) {
  console.log(`${path}: ${(bytes / 1e3).toFixed(0)} kB`);
}

// Grey and alpha to colours.

import type { Stop } from "./data";

export function rgb(colour: string): [number, number, number] {
  const value = Number.parseInt(colour.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

/** 256 colours of a ramp, as 32-bit RGBA in the byte order of a canvas. */
export function table(ramp: Stop[]): Uint32Array {
  const found = new Uint32Array(256);
  for (let grey = 0; grey < 256; grey++) {
    const share = grey / 255;
    let k = ramp.length - 1;
    while (k > 0 && ramp[k][0] > share) k--;
    const [low, from] = ramp[k];
    const [high, to] = ramp[Math.min(k + 1, ramp.length - 1)];
    const t = high > low ? (share - low) / (high - low) : 0;
    const [a, b] = [rgb(from), rgb(to)];
    found[grey] = packed(a.map((v, c) => Math.round(v + (b[c] - v) * t)));
  }
  return found;
}

/** A colour for each of some kinds, by their numbers. */
export function kinds(colours: string[]): Uint32Array {
  const found = new Uint32Array(256);
  colours.forEach((colour, k) => (found[k] = packed(rgb(colour))));
  return found;
}

/** A CSS gradient of a ramp, from left to right. */
export function gradient(ramp: Stop[]): string {
  return `linear-gradient(to right, ${ramp.map(([share, colour]) => `${colour} ${share * 100}%`).join(", ")})`;
}

/** A tile's picture in colours; cells that were not observed are clear. */
export async function paint(blob: Blob, colours: Uint32Array): Promise<HTMLCanvasElement> {
  const { canvas, context, pixels } = await decode(blob);
  const words = new Uint32Array(pixels.data.buffer);
  for (let k = 0; k < words.length; k++) {
    words[k] = pixels.data[4 * k + 3] ? colours[pixels.data[4 * k]] : 0;
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

/** The grey of a pixel of a tile's picture, row 0 in the north; null where it was not observed. */
export async function greyAt(blob: Blob, column: number, row: number): Promise<number | null> {
  const { pixels } = await decode(blob);
  const at = 4 * (row * pixels.width + column);
  return pixels.data[at + 3] ? pixels.data[at] : null;
}

export async function decode(blob: Blob) {
  // As stored: no colour profile of the screen may change a value.
  const image = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  const canvas = document.createElement("canvas");
  canvas.width = image.width;
  canvas.height = image.height;
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(image, 0, 0);
  image.close();
  return { canvas, context, pixels: context.getImageData(0, 0, canvas.width, canvas.height) };
}

function packed([r, g, b]: number[]): number {
  return ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

import type { TexturePicture } from "../client/index.js";

/** Darkest and lightest gray; the finger has a contrast of 3 to all between them (WCAG 1.4.11). */
const GRAYS = { light: [176, 250], dark: [20, 98] } as const;

/** Return a picture of a surface as an image: light where the surface pushes the skin along x. */
export function surfaceImage(
  picture: TexturePicture,
  columns: number,
  shade: keyof typeof GRAYS,
): HTMLCanvasElement {
  const image = document.createElement("canvas");
  [image.width, image.height] = [columns, picture.pixels.length / columns];
  const context = image.getContext("2d") as CanvasRenderingContext2D;
  const data = context.createImageData(image.width, image.height);
  const [darkest, lightest] = GRAYS[shade];
  const colors = new Uint32Array(data.data.buffer);
  picture.pixels.forEach((step, k) => {
    const gray = Math.round(darkest + ((lightest - darkest) * step) / 255);
    colors[k] = 0xff000000 + gray * 0x010101; // opaque, whatever the order of its bytes
  });
  context.putImageData(data, 0, 0);
  return image;
}

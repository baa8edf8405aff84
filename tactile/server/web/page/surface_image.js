/** Darkest and lightest gray, within which the finger and its trace are still seen well. */
const GRAYS = { light: [150, 250], dark: [20, 120] };
/** Return a picture of a surface as an image: light where the surface pushes the skin along x. */
export function surfaceImage(picture, columns, shade) {
    const image = document.createElement("canvas");
    [image.width, image.height] = [columns, picture.pixels.length / columns];
    const context = image.getContext("2d");
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

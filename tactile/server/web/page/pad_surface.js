import { Drawing, isDark } from "./canvas.js";
import { byId, showText } from "./dom.js";
import { MM_PER_PIXEL } from "./finger.js";
import { Newest } from "./newest.js";
import { surfaceImage } from "./surface_image.js";
import { texts } from "./texts.js";
/** Maximum number of pixels of a picture; on larger pads each covers more than a CSS pixel. */
const MOST_PIXELS = 1 << 17;
/** Time for which the size of the pad must rest before the surface is drawn again [ms]. */
const RESTING_MS = 300;
/** Draws the selected surfaces beneath the pad, at the places where the finger meets them. */
export class PadSurface {
    constructor(canvas, session, selection) {
        this.session = session;
        this.selection = selection;
        this.caption = byId("pad-surface-scale");
        this.parts = [];
        this.wasConnected = false;
        this.requests = new Newest((parts) => this.request(parts), (_, error) => error && showText(this.caption, texts.noPicture(error.message)));
        this.drawing = new Drawing(canvas);
        this.drawing.changed.on(() => {
            this.draw();
            clearTimeout(this.resting);
            this.resting = setTimeout(() => this.renew(), RESTING_MS);
        });
        selection.changed.on(() => this.renew());
        session.changed.on(({ isConnected }) => {
            if (isConnected && !this.wasConnected)
                this.renew(); // what was lost with the connection
            this.wasConnected = isConnected;
        });
    }
    /** Return the half of the pad in which a position is. */
    half(x_mm) {
        return x_mm / MM_PER_PIXEL < this.drawing.width / 2 ? "left" : "right";
    }
    renew() {
        const parts = this.wantedParts();
        if (sameParts(parts, this.parts))
            return;
        // While the pad changes its size, what is drawn stays, as positions begin at its lower left.
        this.parts = this.parts.filter(({ texture, left }) => parts.some((each) => each.texture === texture && each.left === left));
        this.draw();
        if (parts.length > 0)
            this.requests.send(parts);
    }
    wantedParts() {
        const { width, height } = this.drawing;
        const { left, right } = this.selection.halves;
        if (left === "" || width === 0 || height === 0)
            return [];
        if (right === "")
            return [{ texture: left, left: 0, width, height }];
        const middle = width / 2;
        return [
            { texture: left, left: 0, width: middle, height },
            { texture: right, left: middle, width: middle, height },
        ];
    }
    async request(parts) {
        for (const part of parts) {
            if (this.parts.some((each) => samePart(each, part)))
                continue;
            const drawn = await this.requestPart(part);
            if (!sameParts(parts, this.wantedParts()))
                return;
            const others = this.parts.filter(({ left }) => left !== part.left);
            this.parts = [...others, drawn].sort((a, b) => a.left - b.left);
            this.draw();
        }
    }
    async requestPart(part) {
        const side = Math.max(1, Math.sqrt((part.width * part.height) / MOST_PIXELS));
        const [columns, rows] = [Math.ceil(part.width / side), Math.ceil(part.height / side)];
        const picture = await this.session.connection.drawTexture({
            texture: part.texture,
            left_mm: part.left * MM_PER_PIXEL,
            bottom_mm: 0,
            pixel_mm: side * MM_PER_PIXEL,
            columns,
            rows,
        });
        return { ...part, picture, columns, side };
    }
    draw() {
        const { drawing, parts } = this;
        const { context, colors, width, height } = drawing;
        drawing.clear();
        for (const part of parts) {
            const { picture, columns, side, left } = part;
            const image = surfaceImage(picture, columns, isDark() ? "dark" : "light");
            const top = height - image.height * side;
            const wanted = this.wantedParts().find((part) => part.left === left);
            context.save();
            context.beginPath(); // one that was drawn for the whole pad ends in its middle now
            context.rect(left, 0, wanted?.width ?? 0, height);
            context.clip();
            context.drawImage(image, left, top, image.width * side, image.height * side);
            context.restore();
        }
        if (this.selection.isDivided) {
            context.fillStyle = colors.text;
            context.fillRect(width / 2 - 1, 0, 2, height);
        }
        drawing.canvas.dataset.textures = parts.map(({ texture }) => texture).join(" ");
        this.showScale();
    }
    showScale() {
        const scales = this.parts.map(({ texture, picture: { lowest_um, highest_um } }) => texts.surfaceScale(texture, lowest_um, highest_um));
        showText(this.caption, scales.join("\n"));
    }
}
function samePart(a, b) {
    return (a.texture === b.texture && a.left === b.left && a.width === b.width && a.height === b.height);
}
function sameParts(a, b) {
    return a.length === b.length && a.every((part, k) => samePart(part, b[k]));
}

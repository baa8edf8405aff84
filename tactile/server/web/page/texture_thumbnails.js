import { surfaceImage } from "./surface_image.js";
/** Number of pixels along a side of a small picture. */
const PIXELS = 48;
/** Side of a pixel [mm]: a picture shows 12 mm, about as much as a fingertip covers. */
const PIXEL_MM = 0.25;
/**
 * Draws a small picture of each texture whose place in the list is in sight, one by one, but none
 * during a stroke or while a contactor is listened to, which need the processor.
 */
export class TextureThumbnails {
    constructor(session, list) {
        this.session = session;
        this.textures = new Map();
        this.inSight = new Set();
        this.busy = false;
        this.observer = new IntersectionObserver((entries) => this.see(entries), { root: list });
        session.changed.on(() => void this.drawAll());
    }
    /** Return the canvas on which a texture will be drawn. */
    create(texture) {
        const canvas = document.createElement("canvas");
        canvas.className = "thumbnail";
        canvas.width = canvas.height = PIXELS;
        canvas.setAttribute("aria-hidden", "true");
        this.textures.set(canvas, texture);
        this.observer.observe(canvas);
        return canvas;
    }
    /** Forget all pictures, before others are created. */
    clear() {
        this.observer.disconnect();
        this.textures.clear();
        this.inSight.clear();
    }
    see(entries) {
        for (const { target, isIntersecting } of entries) {
            if (isIntersecting)
                this.inSight.add(target);
            else
                this.inSight.delete(target);
        }
        void this.drawAll();
    }
    async drawAll() {
        if (this.busy)
            return;
        this.busy = true;
        for (;;) {
            const [canvas] = this.inSight;
            const { isConnected, isHurried } = this.session;
            if (canvas === undefined || !isConnected || isHurried)
                break;
            if (!(await this.draw(canvas)))
                break; // it is tried again when something changes
            this.inSight.delete(canvas);
            this.observer.unobserve(canvas);
        }
        this.busy = false;
    }
    /** Draw a picture; return whether the server has answered. */
    async draw(canvas) {
        const texture = this.textures.get(canvas) ?? "";
        const half_mm = (PIXELS * PIXEL_MM) / 2;
        const corner = { left_mm: -half_mm, bottom_mm: -half_mm, pixel_mm: PIXEL_MM };
        const { connection } = this.session;
        const request = { texture, ...corner, columns: PIXELS, rows: PIXELS };
        try {
            const picture = await connection.drawTexture(request);
            const context = canvas.getContext("2d");
            context.drawImage(surfaceImage(picture, PIXELS, "light"), 0, 0);
            canvas.dataset.drawn = "true";
        }
        catch {
            // The list is useful without pictures; selecting the texture says what is wrong with it.
            return connection === this.session.connection && this.session.isConnected;
        }
        return true;
    }
}

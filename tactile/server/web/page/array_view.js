import { Drawing, onEachFrame, wantsStillness } from "./canvas.js";
import { Contactors, ROOM } from "./contactors.js";
import { byId, setText } from "./dom.js";
import { texts } from "./texts.js";
/** Edge of a contactor as drawn, as a share of the distance to the nearest neighbor. */
const EDGE = 0.4;
/** Distance of the extent of a shear from its contactor, and half a tick [CSS px]. */
const [EXTENT_GAP, TICK] = [6, 2.5];
/** Distance of the frame of the chosen contactor from its edge [CSS px]. */
const CHOICE_GAP = 3;
const DESCRIBE_EVERY_MS = 1000;
/** Draws the contactors of the display: each at its place, moved by its shear, with its drive. */
export class ArrayView {
    constructor(canvas, session, choice) {
        this.choice = choice;
        this.isStale = true;
        /** Whether the server reports what the contactors do. */
        this.isKnown = false;
        this.pixels_per_mm = 1;
        this.center_x_mm = 0;
        this.center_y_mm = 0;
        this.drawing = new Drawing(canvas);
        this.drawing.changed.on(() => this.fit());
        session.displayChanged.on(({ display }) => {
            this.contactors = display && new Contactors(display.info);
            this.fit();
            this.describe();
        });
        session.telemetry.on((telemetry) => {
            const moves = this.contactors?.take(telemetry, performance.now()) ?? false;
            this.isStale ||= moves;
        });
        session.changed.on(({ state }) => this.setKnown(state !== "offline" && state !== "lost"));
        canvas.title = texts.chooseContactor;
        canvas.addEventListener("click", ({ offsetX, offsetY }) => this.chooseAt(offsetX, offsetY));
        choice.changed.on(() => (this.isStale = true));
        onEachFrame(() => this.draw());
        setInterval(() => this.describe(), DESCRIBE_EVERY_MS);
    }
    /** Choose the contactor that is nearest to a point of the drawing. */
    chooseAt(x, y) {
        if (!this.contactors?.all.length)
            return;
        const distances = this.contactors.all.map(({ x_mm, y_mm }) => Math.hypot(this.x(x_mm) - x, this.y(y_mm) - y));
        this.choice.choose(distances.indexOf(Math.min(...distances)));
    }
    /** Choose the scale of the drawing so that the display fills it. */
    fit() {
        this.isStale = true;
        const { contactors, drawing } = this;
        if (!contactors)
            return;
        const xs = contactors.all.map(({ x_mm }) => x_mm);
        const ys = contactors.all.map(({ y_mm }) => y_mm);
        const [left, right] = [Math.min(...xs), Math.max(...xs)];
        const [bottom, top] = [Math.min(...ys), Math.max(...ys)];
        const margin_mm = 2 * (ROOM + EDGE) * contactors.pitch_mm;
        this.center_x_mm = (left + right) / 2;
        this.center_y_mm = (bottom + top) / 2;
        this.pixels_per_mm = Math.min(drawing.width / (right - left + margin_mm), drawing.height / (top - bottom + margin_mm));
    }
    setKnown(isKnown) {
        if (isKnown === this.isKnown)
            return;
        this.isKnown = isKnown;
        this.isStale = true;
        this.drawing.canvas.dataset.known = String(isKnown); // style.css fades what is not known
        this.describe();
    }
    /** Say in words what is drawn. */
    describe() {
        if (!this.contactors)
            return;
        const { all, limit_v, scale, hasShear, largestShear_um, largestDrive_v } = this.contactors;
        const shear_um = hasShear ? largestShear_um : undefined;
        const [short, long] = this.isKnown
            ? [
                texts.arrayInShort(shear_um, largestDrive_v, limit_v),
                texts.array(all.length, shear_um, largestDrive_v, limit_v),
            ]
            : [texts.arrayUnknown, texts.arrayUnknown];
        setText(byId("array-description"), short);
        this.drawing.canvas.setAttribute("aria-label", long);
        const um_per_mm = hasShear ? scale.um_per_mm : undefined;
        const isStill = hasShear && wantsStillness();
        const scaleText = isStill ? texts.arrayStill(limit_v) : texts.arrayScale(um_per_mm, limit_v);
        setText(byId("array-scale"), scaleText);
    }
    draw() {
        if (!this.isStale)
            return;
        this.isStale = false;
        this.drawing.clear();
        const { contactors } = this;
        if (!contactors)
            return;
        const moves = this.isKnown && contactors.isArmed && !wantsStillness();
        const pixels_per_um = moves ? this.pixels_per_mm / contactors.scale.um_per_mm : 0;
        const edge = EDGE * contactors.pitch_mm * this.pixels_per_mm;
        if (moves)
            this.drawExtents(contactors, pixels_per_um, edge / 2 + EXTENT_GAP);
        for (const contactor of contactors.all) {
            const drive_v = this.isKnown ? Math.abs(contactor.drive_v) : 0;
            const share = Math.min(drive_v / contactors.limit_v, 1);
            this.drawContactor(contactor, pixels_per_um, edge, share);
        }
        const chosen = contactors.all[this.choice.contactor];
        if (chosen)
            this.drawChoice(chosen, pixels_per_um, edge + 2 * CHOICE_GAP);
    }
    /**
     * Draw the extent of each shear beside the contactor, with a tick at its place. All are one path,
     * which is much faster than one path each.
     */
    drawExtents({ all }, pixels_per_um, beside) {
        const { context, colors } = this.drawing;
        context.beginPath();
        for (const { x_mm, y_mm, along, up, extent } of all) {
            const [from, to] = [extent.from * pixels_per_um, extent.to * pixels_per_um];
            const [x, y] = [this.x(x_mm) + up * beside, this.y(y_mm) + along * beside];
            context.moveTo(x + along * from, y - up * from);
            context.lineTo(x + along * to, y - up * to);
            context.moveTo(x - up * TICK, y - along * TICK);
            context.lineTo(x + up * TICK, y + along * TICK);
        }
        context.strokeStyle = colors.muted;
        context.lineWidth = 1.5;
        context.stroke();
    }
    /** Draw one contactor as a square with a bar for the share of its drive in the limit. */
    drawContactor(contactor, pixels_per_um, edge, share) {
        const { context, colors } = this.drawing;
        const [x, y] = this.corner(contactor, pixels_per_um, edge);
        context.fillStyle = colors.panel;
        context.fillRect(x, y, edge, edge);
        context.fillStyle = colors.drive;
        context.globalAlpha = 0.1 + 0.3 * share;
        context.fillRect(x, y, edge, edge);
        context.globalAlpha = 1;
        context.fillRect(x, y + edge * (1 - share), edge, edge * share);
        context.strokeStyle = colors.muted;
        context.lineWidth = 1;
        context.strokeRect(x, y, edge, edge);
    }
    /** Draw a frame around the contactor that is chosen. */
    drawChoice(chosen, pixels_per_um, edge) {
        const { context, colors } = this.drawing;
        const [x, y] = this.corner(chosen, pixels_per_um, edge);
        context.strokeStyle = colors.text;
        context.lineWidth = 2;
        context.strokeRect(x, y, edge, edge);
    }
    /** Return the left upper corner of a square around a contactor, which its shear has moved. */
    corner({ x_mm, y_mm, along, up, shear_um }, pixels_per_um, edge) {
        const way = shear_um * pixels_per_um;
        return [this.x(x_mm) + along * way - edge / 2, this.y(y_mm) - up * way - edge / 2];
    }
    x(x_mm) {
        return this.drawing.width / 2 + (x_mm - this.center_x_mm) * this.pixels_per_mm;
    }
    y(y_mm) {
        return this.drawing.height / 2 - (y_mm - this.center_y_mm) * this.pixels_per_mm;
    }
}

import { MM_PER_PIXEL, PRESSURE_OF_A_MOUSE } from "./finger.js";
/** Let a mouse, a pen or a finger on the screen move the finger of the display. */
export function strokeByPointer(pad, finger) {
    let pointer;
    const move = (event) => {
        if (event.pointerId === pointer)
            touchAt(pad, finger, event);
    };
    const end = (event) => {
        if (event.pointerId !== pointer)
            return;
        pointer = undefined;
        finger.lift(event.timeStamp);
    };
    pad.addEventListener("pointerdown", (event) => {
        if (pointer !== undefined || event.button !== 0)
            return;
        pointer = event.pointerId;
        pad.setPointerCapture(pointer);
        touchAt(pad, finger, event);
    });
    // Raw updates come as soon as the pointer moves, the others only before the next frame.
    pad.addEventListener("pointerrawupdate", move);
    pad.addEventListener("pointermove", move);
    pad.addEventListener("pointerup", end);
    pad.addEventListener("pointercancel", end);
    pad.addEventListener("lostpointercapture", end);
    onLeaving(() => {
        pointer = undefined;
        finger.lift(performance.now());
    });
}
/** Call a function when the user leaves the page, after which no events may come. */
export function onLeaving(leave) {
    addEventListener("blur", leave);
    addEventListener("pagehide", leave);
    document.addEventListener("visibilitychange", () => document.hidden && leave());
}
function touchAt(pad, finger, event) {
    const box = pad.getBoundingClientRect();
    const coalesced = event.getCoalescedEvents?.() ?? [];
    for (const { clientX, clientY, pressure, timeStamp } of coalesced.length ? coalesced : [event]) {
        const x_mm = (clientX - box.left) * MM_PER_PIXEL;
        const y_mm = (box.bottom - clientY) * MM_PER_PIXEL;
        // A force of 0 would lift the finger, and some screens do not measure the pressure.
        finger.touch(x_mm, y_mm, pressure || PRESSURE_OF_A_MOUSE, timeStamp);
    }
}

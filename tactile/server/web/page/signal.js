/** Something that happens, to which functions can be attached. */
export class Signal {
    constructor() {
        this.listeners = new Set();
    }
    /** Call a function each time. Returns the function that ends that. */
    on(listener) {
        this.listeners.add(listener);
        return () => void this.listeners.delete(listener);
    }
    /** Call all attached functions with a value. */
    emit(value) {
        for (const listener of this.listeners)
            listener(value);
    }
}

/** Something that happens, to which functions can be attached. */
export class Signal<T> {
  private readonly listeners = new Set<(value: T) => void>();

  /** Call a function each time. Returns the function that ends that. */
  on(listener: (value: T) => void): () => void {
    this.listeners.add(listener);
    return () => void this.listeners.delete(listener);
  }

  /** Call all attached functions with a value. */
  emit(value: T): void {
    for (const listener of this.listeners) listener(value);
  }
}

import { labels, texts } from "./texts.js";

/** Return the element of an id. A missing one is a mistake of this page. */
export function byId<T extends HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`no element #${id}`);
  return element as T;
}

/** Create an element with a text, which is never read as HTML. */
export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  text = "",
  className = "",
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** Set a text only if it differs, because a change makes the browser lay out the page again. */
export function setText(target: HTMLElement, text: string): void {
  if (target.textContent !== text) target.textContent = text;
}

/** Show a text in an element, which is hidden while there is none. */
export function showText(target: HTMLElement, text: string): void {
  setText(target, text);
  target.hidden = text === "";
}

/** Write the constant texts of the page, which its `data-text` and similar attributes name. */
export function writeConstantTexts(): void {
  for (const target of document.querySelectorAll<HTMLElement>("[data-text]")) {
    target.textContent = labels[target.dataset.text as keyof typeof labels];
  }
  for (const target of document.querySelectorAll<HTMLElement>("[data-label]")) {
    target.setAttribute("aria-label", labels[target.dataset.label as keyof typeof labels]);
  }
  for (const target of document.querySelectorAll<HTMLInputElement>("[data-placeholder]")) {
    target.placeholder = labels[target.dataset.placeholder as keyof typeof labels];
  }
  document.title = texts.title("");
}

import { labels, texts } from "./texts.js";
/** Return the element of an id. A missing one is a mistake of this page. */
export function byId(id) {
    const element = document.getElementById(id);
    if (element === null)
        throw new Error(`no element #${id}`);
    return element;
}
/** Create an element with a text, which is never read as HTML. */
export function element(tag, text = "", className = "") {
    const made = document.createElement(tag);
    made.textContent = text;
    if (className)
        made.className = className;
    return made;
}
/** Set a text only if it differs, because a change makes the browser lay out the page again. */
export function setText(target, text) {
    if (target.textContent !== text)
        target.textContent = text;
}
/** Show a text in an element, which is hidden while there is none. */
export function showText(target, text) {
    setText(target, text);
    target.hidden = text === "";
}
/** Write the constant texts of the page, which its `data-text` and similar attributes name. */
export function writeConstantTexts() {
    for (const target of document.querySelectorAll("[data-text]")) {
        target.textContent = labels[target.dataset.text];
    }
    for (const target of document.querySelectorAll("[data-label]")) {
        target.setAttribute("aria-label", labels[target.dataset.label]);
    }
    for (const target of document.querySelectorAll("[data-placeholder]")) {
        target.placeholder = labels[target.dataset.placeholder];
    }
    document.title = texts.title("");
}

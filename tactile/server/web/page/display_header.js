import { byId, element, setText } from "./dom.js";
import { texts } from "./texts.js";
/** Show the name of the display, its state, and what this page may do with it. */
export function showDisplayHeader(session) {
    const choice = byId("display-choice");
    choice.addEventListener("change", () => session.show(choice.value));
    session.changed.on(() => {
        showNames(session, choice);
        showState(session);
    });
    showState(session);
}
function showNames(session, choice) {
    const names = session.connection.displays.map(({ name }) => name);
    const name = session.display?.name ?? "";
    const single = byId("display-name");
    choice.hidden = names.length < 2;
    single.hidden = !choice.hidden;
    setText(single, name);
    document.title = texts.title(name);
    const shown = Array.from(choice.options, ({ value }) => value);
    if (shown.join("\n") !== names.join("\n")) {
        choice.replaceChildren(...names.map((each) => element("option", each)));
    }
    choice.value = name;
}
function showState(session) {
    const { state } = session;
    byId("state").dataset.state = state;
    document.body.dataset.state = state;
    setText(byId("state-word"), texts.states[state]);
}

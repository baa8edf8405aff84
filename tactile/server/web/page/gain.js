import { byId, setText, showText } from "./dom.js";
import { Newest } from "./newest.js";
import { texts } from "./texts.js";
/** Let the slider scale what this page plays. */
export function handleGain(session) {
    const slider = byId("gain");
    const value = byId("gain-value");
    const problem = byId("gain-problem");
    const percents = new Map();
    const gain = new Newest(async (percent) => session.display?.gain(percent / 100), (_, error) => showText(problem, error ? texts.gainFailed(error.message) : ""));
    const show = (percent) => {
        slider.value = String(percent);
        setText(value, texts.percent(percent));
        slider.setAttribute("aria-valuetext", texts.percent(percent));
    };
    slider.addEventListener("input", () => {
        const percent = Number(slider.value);
        if (session.display)
            percents.set(session.display.name, percent);
        show(percent);
        gain.send(percent);
    });
    session.reopened.on(() => percents.clear());
    session.displayChanged.on(() => show(percents.get(session.display?.name ?? "") ?? 100));
    session.changed.on(() => (slider.disabled = session.state === "offline" || !session.may("play")));
    show(100);
}
